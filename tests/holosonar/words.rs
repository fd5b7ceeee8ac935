//! The manual pages, and the stages that `-v` lists.

use crate::binary::{done, files_below, run, small};

#[test]
fn every_command_has_a_manual_page() {
    let folder = tempfile::tempdir().unwrap();
    let page = done(folder.path(), "man");
    assert!(page.contains(".TH holosonar 1") && page.contains("reconstruct") && page.contains("130"));
    done(folder.path(), "man pages");
    let written = files_below(&folder.path().join("pages"));
    let help = done(folder.path(), "--help");
    let (_, commands) = help.split_once("Commands:\n").unwrap();
    let commands =
        commands.lines().map_while(|line| line.strip_prefix("  ")).filter(|line| !line.starts_with(' '));
    let commands: Vec<&str> = commands.filter_map(|line| line.split_whitespace().next()).collect();
    assert!(commands.contains(&"image") && commands.contains(&"man"), "{commands:?}");
    for command in commands.into_iter().filter(|command| *command != "help") {
        let path = folder.path().join(format!("pages/holosonar-{command}.1"));
        assert!(written.contains(&path), "{} is missing", path.display());
        assert!(std::fs::read_to_string(path).unwrap().contains("SYNOPSIS"), "{command}");
    }
}

#[test]
fn a_file_without_a_command_gets_a_suggestion() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("part.stl"), "").unwrap();
    let ran = run(folder.path(), "part.stl");
    assert_eq!((ran.status, ran.stdout.as_str()), (2, ""));
    assert!(ran.stderr.contains("holosonar image part.stl -o DIR"), "{}", ran.stderr);
    assert!(
        run(folder.path(), "imge part.stl").stderr.contains("'image'"),
        "other slips keep their own advice"
    );
}

#[test]
fn verbose_says_what_each_stage_did() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("bracket.toml");
    let said = run(folder.path(), &format!("image {} -o out -v", scene.display())).stderr;
    let stages =
        ["reading the scene", "tracing echoes", "simulating", "reconstructing", "locating depth", "writing"];
    for stage in stages {
        let line =
            said.lines().find(|line| line.starts_with(stage)).unwrap_or_else(|| panic!("{stage}: {said}"));
        let seconds = line[stage.len()..].trim().strip_suffix(" s").unwrap_or_else(|| panic!("{line}"));
        assert!(seconds.trim().parse::<f64>().unwrap() < 600.0, "{line}");
    }
    for note in ["triangles", "reflectors", "microphones", "voxels", "return", "files in out"] {
        assert!(said.lines().any(|line| line.starts_with("  ") && line.contains(note)), "{note}: {said}");
    }
    assert!(
        !run(folder.path(), &format!("image {} -o out", scene.display())).stderr.contains(" s\n"),
        "only when asked to"
    );
}
