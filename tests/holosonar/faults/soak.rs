//! An hour, or as long as `HOLOSONAR_SOAK` says in seconds, of small jobs under whatever may happen to them: few threads or
//! many, too little memory, address space, disk space, inodes, open files or length of a file, signals at any moment.
//! Whatever happens, a job ends with a status that is documented, each file that it leaves has the bytes of an undisturbed
//! run, and the same command then resumes to all of them.

use super::starved::Disk;
use super::{IMAGE, JOBS, Job, contents, end, reused, states, undisturbed, workplace};
use crate::binary::{Outcome, STATE_HOME};
use crate::support::Random;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Small changes, each of a scene and of a cube, so that there are many jobs.
const VARIATIONS: [&str; 4] =
    ["", " --set reconstruct.window=hann", " --set medium.sound_speed=340", " --set medium.sound_speed=346"];

/// Seconds, unless the environment says otherwise.
const SECONDS: u64 = 60;

/// What happens to one job.
#[derive(Debug, Default)]
struct Trouble {
    /// Options of the program.
    options: Vec<String>,
    /// Commands of the shell before it.
    limits: Vec<String>,
    /// Size and inodes of the file system that holds the output.
    disk: Option<String>,
    /// A signal, and after which part of the time that the job takes.
    signal: Option<(&'static str, f64)>,
}

impl Trouble {
    fn of(random: &mut Random) -> Self {
        let mut trouble = Self::default();
        if random.whole(0, 1) == 0 {
            trouble.options.push(format!("-j {}", random.one(&[1, 2, 3, 5, 16, 64])));
        }
        if random.whole(0, 3) > 0 {
            trouble.options.push("--checkpoint-every 0".to_owned());
        }
        for _ in 0..random.whole(0, 2) {
            match random.whole(0, 6) {
                0 => trouble.options.push(format!("--memory {}MiB", random.whole(1, 120))),
                1 => trouble.limits.push(format!("ulimit -v {};", random.whole(64_000, 1_200_000))),
                2 => trouble.limits.push(format!("ulimit -n {};", random.whole(4, 40))),
                3 => trouble.limits.push(format!("ulimit -f {};", random.whole(0, 12_000))),
                4 => trouble.disk = Some(format!("size={}k", random.whole(100, 20_000))),
                5 => trouble.disk = Some(format!("size=200m,nr_inodes={}", random.whole(1, 12))),
                _ => {
                    let signal = *random.one(&["-INT", "-TERM", "-KILL"]);
                    trouble.signal = Some((signal, random.uniform(0.0, 1.2)));
                }
            }
        }
        trouble
    }

    /// Runs a job that takes `whole` by itself.
    fn run(&self, folder: &Path, words: &str, whole: Duration) -> Outcome {
        let line = format!("{} exec \"$0\" {words} {}", self.limits.join(" "), self.options.join(" "));
        let mut shell = Command::new("sh");
        shell.current_dir(folder).args(["-c", &line, env!("CARGO_BIN_EXE_holosonar")]).stdin(Stdio::null());
        shell.env("XDG_STATE_HOME", STATE_HOME).env("RUST_BACKTRACE", "0");
        let child = shell.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        if let Some((signal, share)) = self.signal {
            std::thread::sleep(whole.mul_f64(share));
            let _ =
                Command::new("kill").args([signal, &child.id().to_string()]).stderr(Stdio::null()).status();
        }
        end(child)
    }
}

type Files = Vec<(PathBuf, Vec<u8>)>;

/// The files that are shown; what begins with a dot is a checkpoint, or what a killed process left of an output.
fn shown(folder: &Path) -> Files {
    let hidden = |path: &Path| path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    contents(folder).into_iter().filter(|(name, _)| !hidden(name)).collect()
}

#[test]
#[ignore = "a minute, or as long as HOLOSONAR_SOAK says"]
fn whatever_happens_to_a_job_its_files_are_right_or_missing() {
    let seconds = std::env::var("HOLOSONAR_SOAK").map_or(SECONDS, |seconds| seconds.parse().unwrap());
    let seed = std::env::var("HOLOSONAR_SEED").map_or(1, |seed| seed.parse().unwrap());
    let folder = workplace();
    let folder = folder.path();
    let output = folder.join(IMAGE.output);
    let mut random = Random::new(seed);
    let mut known: HashMap<(usize, usize), (Files, Duration)> = HashMap::new();
    let (mut ends, mut resumed, mut blocks, mut late) = (BTreeMap::<i32, usize>::new(), 0, 0, 0);
    let begun = Instant::now();
    // On a slow machine not only until the time is over.
    while begun.elapsed() < Duration::from_secs(seconds) || resumed == 0 {
        let (which, variation) = (random.whole(0, JOBS.len() - 1), random.whole(0, VARIATIONS.len() - 1));
        let words = format!("{}{}", JOBS[which].words, VARIATIONS[variation]);
        let job = Job { words: Box::leak(words.clone().into_boxed_str()), output: IMAGE.output };
        let (expected, whole) = known.entry((which, variation)).or_insert_with(|| undisturbed(folder, &job));
        let trouble = Trouble::of(&mut random);
        fs::create_dir_all(&output).unwrap();
        let disk = trouble.disk.as_ref().and_then(|options| Disk::mount_at(&output, options));
        let ran = trouble.run(folder, &words, *whole);
        let what =
            format!("job {} of seed {seed}: {words}: {trouble:?}: {ran:?}", ends.values().sum::<usize>());
        assert!(!ran.stderr.contains("panicked"), "{what}");
        // An allocation too small to be checked may fail where there are hardly any addresses.
        if ran.stderr.contains("memory allocation of") {
            assert!(
                ran.status == 1 && trouble.limits.iter().any(|limit| limit.starts_with("ulimit -v")),
                "{what}"
            );
            late += 1;
        }
        let killed = matches!(trouble.signal, Some(("-KILL", _))) && ran.status == -1;
        assert!(killed || [0, 1, 2, 130, 143].contains(&ran.status), "{what}");
        let found = shown(&output);
        for (name, bytes) in &found {
            let right = expected.iter().find(|(other, _)| other == name);
            assert!(right.is_some_and(|(_, right)| right == bytes), "{} is wrong: {what}", name.display());
        }
        assert!(ran.status != 0 || found.len() == expected.len(), "files are missing: {what}");
        *ends.entry(ran.status).or_default() += 1;
        // The same command, when all is well again.
        if ran.status != 0 {
            if let Some(disk) = &disk {
                assert!(disk.set("size=400m,nr_inodes=1000", true));
            }
            let again = Trouble::default().run(folder, &words, *whole);
            assert_eq!(again.status, 0, "{what}, then {again:?}");
            assert!(shown(&output) == *expected, "{what}, then {again:?}");
            assert_eq!(states(folder, &job), Vec::<PathBuf>::new(), "{what}, then {again:?}");
            resumed += 1;
            blocks += reused(&again);
        }
        drop(disk);
        fs::remove_dir_all(&output).unwrap();
    }
    println!(
        "{ends:?} jobs by status in {seconds} s, {late} short of memory found late; {resumed} done again, {blocks} blocks \
         were not computed again"
    );
}
