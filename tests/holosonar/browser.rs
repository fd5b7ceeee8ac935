//! `report --open`, with a script in place of the system's browser.

use crate::binary::{Outcome, command, run_command, shipped};
use std::ffi::OsStr;
use std::os::unix::fs::PermissionsExt;

#[test]
fn a_page_is_opened_or_the_error_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let scene = shipped("point.toml");
    let image = run_command(
        "image point.toml -o out",
        &mut command(path, [OsStr::new("image"), scene.as_os_str(), OsStr::new("-o"), OsStr::new("out")]),
    );
    assert_eq!(image.status, 0, "{}", image.stderr);
    let programs = path.join("programs");
    std::fs::create_dir(&programs).unwrap();
    let open = || -> Outcome {
        run_command("report out --open", command(path, ["report", "out", "--open"]).env("PATH", &programs))
    };
    let page = std::path::absolute(path.join("out/report.html")).unwrap();
    let failed = |ran: Outcome, words: &str| {
        assert_eq!(ran.status, 1, "{}", ran.stderr);
        for words in ["--open", words, page.to_str().unwrap()] {
            assert!(ran.stderr.contains(words), "`{words}` is missing: {}", ran.stderr);
        }
        assert!(ran.stdout.contains("report.html"), "the page is there all the same: {}", ran.stdout);
    };
    failed(open(), "no program");
    let opener = programs.join("xdg-open");
    let script = |text: &str| {
        std::fs::write(&opener, format!("#!/bin/sh\n{text}\n")).unwrap();
        std::fs::set_permissions(&opener, std::fs::Permissions::from_mode(0o755)).unwrap();
    };
    script("exit 4");
    failed(open(), "xdg-open");
    script("printf %s \"$1\" > opened");
    let ran = open();
    assert_eq!((ran.status, ran.stderr.as_str()), (0, ""));
    assert_eq!(std::fs::read_to_string(path.join("opened")).unwrap(), page.to_str().unwrap());
}
