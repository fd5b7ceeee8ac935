//! No text makes the reader panic, hang or write an overlong message.

use super::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

#[test]
fn nothing_panics_on_mutated_files() {
    let scraps: [&[u8]; 16] = [
        b"[",
        b"]",
        b"=",
        b"\"",
        b"1e400",
        b"-1",
        b"0",
        b"nan",
        b"\n",
        b"[[",
        b"{",
        b"99999999999999999999",
        b".",
        b"'",
        b"\xff",
        b"\xc3\xa4",
    ];
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut below = |n: usize| random.next_u64() as usize % n;
    let (mut good, mut bad) = (0, 0);
    for _ in 0..2000 {
        let mut bytes = ANNOTATED.as_bytes().to_vec();
        // Mostly one change, so that many get past the syntax.
        for _ in 0..=below(3) {
            let at = below(bytes.len());
            let end = (at + below(6)).min(bytes.len());
            match below(3) {
                0 => drop(bytes.drain(at..end)),
                1 => drop(bytes.splice(at..end, scraps[below(scraps.len())].iter().copied())),
                _ => bytes[at] = below(256) as u8,
            }
        }
        match read(&String::from_utf8_lossy(&bytes)) {
            Ok(run) => {
                good += 1;
                assert_eq!(read(&run.to_toml()).unwrap(), run);
            }
            Err(error) => {
                bad += 1;
                assert_eq!(error.exit_status(), 2);
                assert!(error.to_string().len() < 1500, "{error}");
            }
        }
    }
    assert!(good > 100 && bad > 100, "{good} read and {bad} were refused");
}

#[test]
fn nothing_panics_on_absurd_text() {
    let deep = "a.".repeat(100_000);
    for text in [
        "[".repeat(100_000),
        format!("a = {}", "[".repeat(100_000)),
        format!("{deep}a = 1"),
        format!("[{deep}a]"),
        format!("scene.{deep}a = 1"),
        format!("\"{}\" = 1", "x".repeat(500_000)),
        format!("[sweep]\nstep = {}", "9".repeat(100_000)),
        "\0".to_owned(),
        "[scene]\nmesh = \"\\u0000\"\n[scene.mesh]".to_owned(),
        "[grid]\nx=1e308\ny=0\nz=0\npitch=[1e308,1,1]\ncount=[4294967295,1,1]".to_owned(),
        "[grid]\nx=[-1e308,1e308]\ny=[0,1]\nz=[0,1]\npitch=[1e-308,1,1]".to_owned(),
        "[sweep]\nstart=1e308\nstop=1.7e308\nstep=5e-324".to_owned(),
        "[array]\nextent=[1e308,1e308]\ncount=[1,1]".to_owned(),
    ] {
        assert!(read(&text).is_err(), "{}", text.chars().take(60).collect::<String>());
    }
    for typed in
        [format!("{deep}a=1"), format!("scene.mesh={}", "[".repeat(100_000)), format!("scene.{deep}b=1")]
    {
        assert!(read_with("", &[&typed]).is_err());
    }
    let many: Vec<String> = (0..20).map(|_| "x".repeat(1000)).collect();
    assert!(refused(&format!("[grid]\n\"{}\" = 1", many.concat())).len() < 400);
}
