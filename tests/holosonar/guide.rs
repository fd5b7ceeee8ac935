//! The guide in the terminal and on manual pages, and what it points to. Its examples are run by
//! `tests/readers/check_guide.py`.

use crate::binary::{done, refused};
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The chapters, by the name of their file.
fn chapters() -> Vec<PathBuf> {
    let mut chapters: Vec<PathBuf> =
        fs::read_dir(root().join("src/guide")).unwrap().map(|entry| entry.unwrap().path()).collect();
    chapters.sort();
    assert!(chapters.len() >= 10 && chapters.iter().all(|path| path.extension().is_some_and(|e| e == "md")));
    chapters
}

/// The topic of a chapter's file.
fn topic(chapter: &Path) -> String {
    chapter.file_stem().unwrap().to_str().unwrap().replace('_', "-")
}

#[test]
fn help_explains_commands_and_topics_alike() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    assert_eq!(done(folder, "help"), done(folder, "--help"));
    assert_eq!(done(folder, "help image"), done(folder, "image --help"));
    let topics = done(folder, "help topics");
    for chapter in chapters() {
        let name = topic(&chapter);
        assert!(topics.contains(&format!("\n  {name} ")), "{name}: {topics}");
        let shown = done(folder, &format!("help {name}"));
        let heading = fs::read_to_string(&chapter).unwrap();
        let heading = heading.lines().next().unwrap().strip_prefix("# ").unwrap().to_uppercase();
        assert!(shown.starts_with(&format!("{heading}\n\n")), "{name}: {}", &shown[..80]);
        assert!(shown.lines().count() > 30, "{name} is a chapter");
    }
    // The whole annotated file, and other ways to type its name.
    let run_file = done(folder, "help run-file");
    for line in holosonar::config::ANNOTATED.lines() {
        assert!(run_file.contains(line), "{line}");
    }
    assert_eq!(run_file, done(folder, "help run file"));
    assert_eq!(run_file, done(folder, "help Run_File"));
}

#[test]
fn a_mistyped_topic_is_answered_with_the_nearest() {
    let folder = tempfile::tempdir().unwrap();
    refused(folder.path(), "help fysics", 2, &["fysics", "physics"]);
    refused(folder.path(), "help reconstruckt", 2, &["reconstruct"]);
    refused(folder.path(), "help xylophone", 2, &["xylophone", "holosonar help"]);
}

#[test]
fn every_chapter_has_a_manual_page() {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), "man pages");
    for chapter in chapters() {
        let name = topic(&chapter);
        let page = fs::read_to_string(folder.path().join(format!("pages/holosonar-guide-{name}.7"))).unwrap();
        assert!(page.contains(&format!(".TH holosonar-guide-{name} 7")), "{name}");
        assert!(page.contains("\n.SH DESCRIPTION\n") && page.contains("\n.PP\n"), "{name}");
        // Every line that begins with a dot is a request that pages know, none is text by mistake.
        for line in page.lines().filter(|line| line.starts_with('.')) {
            let request = line[1..].split(' ').next().unwrap();
            let known = ["ie", "el", "TH", "SH", "SS", "PP", "IP", "RS", "RE", "nf", "fi"];
            assert!(known.contains(&request), "{name}: {line}");
        }
    }
}

/// The targets of a document's links, inline and by reference.
fn links(text: &str) -> Vec<String> {
    let inline = text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
    let images =
        text.split("src=\"").skip(1).filter_map(|rest| rest.split_once('"')).map(|(target, _)| target);
    let references =
        text.lines().filter(|line| line.starts_with('[')).filter_map(|line| line.split_once("]: "));
    inline.chain(images).chain(references.map(|(_, target)| target)).map(str::to_owned).collect()
}

#[test]
fn links_lead_somewhere() {
    let mut count = 0;
    for document in chapters().into_iter().chain([root().join("README.md")]) {
        let text = fs::read_to_string(&document).unwrap();
        for target in links(&text) {
            assert!(document.parent().unwrap().join(&target).is_file(), "{}: {target}", document.display());
            count += 1;
        }
        // A reference without a definition would be shown with its brackets.
        for name in text.split('[').skip(1).filter_map(|rest| rest.split_once(']')) {
            let (name, rest) = name;
            let is_topic = root().join(format!("src/guide/{}.md", name.replace('-', "_"))).is_file();
            if is_topic && !rest.starts_with(':') && !rest.starts_with('(') {
                assert!(text.contains(&format!("\n[{name}]: ")), "{}: [{name}]", document.display());
            }
        }
    }
    assert!(count > 30, "{count}");
}

#[test]
fn files_that_the_guide_names_are_there() {
    let mut count = 0;
    for document in chapters() {
        let text = fs::read_to_string(&document).unwrap();
        for name in text.split('`').skip(1).step_by(2) {
            let rooted =
                ["src/", "tests/", "benches/", "scenes/", ".ci/"].iter().any(|start| name.starts_with(start));
            if rooted && !name.contains(['*', '\n', ' ']) && !name.contains("NAME") {
                assert!(root().join(name).exists(), "{}: {name}", document.display());
                count += 1;
            }
        }
        // The code chapter names a test by its file alone, and a module of `reconstruct` by its path there.
        if document.file_stem().is_some_and(|stem| stem == "code") {
            let (_, tests) = text.split_once("## Tests").unwrap();
            let (tests, _) = tests.split_once("## How to add").unwrap();
            let names =
                tests.split('`').skip(1).step_by(2).filter(|name| Path::new(name).extension().is_some());
            for name in names.filter(|name| Path::new(name).extension().is_some_and(|e| e == "rs")) {
                assert!(root().join("tests/holosonar").join(name).is_file(), "{name}");
            }
            let (_, rooms) = text.split_once("| room |").unwrap();
            let (rooms, _) = rooms.split_once("## Conventions").unwrap();
            for room in rooms.split('`').skip(1).step_by(2) {
                assert!(root().join("src/reconstruct").join(room).exists(), "{room}");
                count += 1;
            }
        }
    }
    assert!(count > 30, "{count}");
}
