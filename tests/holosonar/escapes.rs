//! Names and lines that come from files: shown without acting on the terminal, and never at full length.

use crate::binary::{Outcome, command, json, run};
use std::fs;
use std::path::Path;

/// An escape sequence, a bell, a carriage return, a reversal of the direction, and a second line.
const HOSTILE: &str = "\u{1b}]0;title\u{7}\r\u{202e}\u{9b}2J\nerror: forged";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let name = serde_json::to_string(HOSTILE).unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write(
        "named.gltf",
        &format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0,"name":{name}}}],
            "meshes":[{{"name":{name},"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
            "materials":[{{"name":{name}}}],"buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAIA/AACAPwAAAAAAAIA/AAAAAAAAgD8AAIA/"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,1],"max":[1,1,1]}}]}}"#
        ),
    );
    write("long.csv", &format!("x,y,z,amplitude\n{HOSTILE}{}\n", "9".repeat(1 << 20)));
    write("word.stl", &format!("solid a\n{}\u{1b}[2J\nendsolid\n", "word".repeat(1 << 16)));
    write("key.toml", &format!("[grid]\n\"{}\\u001b\" = 1\n", "key".repeat(1 << 16)));
    write("material.obj", "mtllib material.mtl\nusemtl a\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n");
    write("material.mtl", &format!("newmtl a\nd \u{1b}[31m{}\n", "1".repeat(1 << 16)));
    folder
}

/// That nothing in an output acts on a terminal, and that it has no line that a file forged.
fn assert_harmless(words: &str, ran: &Outcome) {
    for text in [&ran.stdout, &ran.stderr] {
        let acting = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
        assert!(!text.contains(acting), "{words}: {text:?}");
        assert!(!text.lines().any(|line| line.starts_with("error: forged")), "{words}: {text}");
    }
}

#[test]
fn names_act_on_no_terminal() {
    let folder = folder();
    for words in ["info named.gltf", "image named.gltf -o out", "plan named.gltf", "info out/volume.npz"] {
        let ran = run(folder.path(), words);
        assert_eq!(ran.status, 0, "{words}: {}", ran.stderr);
        assert_harmless(words, &ran);
    }
    let shown = run(folder.path(), "info named.gltf");
    assert!(shown.stdout.contains("\\u{1b}]0;title\\u{7}\\r"), "{}", shown.stdout);
    let shown = run(folder.path(), "info named.gltf --json");
    assert_harmless("--json", &shown);
    assert!(json(&shown.stdout).to_string().contains("]0;title"), "{}", shown.stdout);
}

#[test]
fn refusals_are_short_and_act_on_no_terminal() {
    let folder = folder();
    let named = ["-o", "out", "--set", "scene.sensor=node:\u{1b}[2J", "named.gltf"];
    let mut commands = vec![("sensor", command(folder.path(), ["image"].into_iter().chain(named)))];
    for words in [
        "info long.csv",
        "info word.stl --unit m",
        "info key.toml",
        "info material.obj --unit m",
        "image long.csv -o out",
    ] {
        commands.push((words, command(folder.path(), words.split(' '))));
    }
    #[cfg(unix)]
    commands.push(("a file", command(folder.path(), ["info", "no\u{1b}[2J\nerror: forged.npz"])));
    for (words, mut command) in commands {
        let ran = Outcome::of(command.output().unwrap());
        assert_eq!(ran.status, 2, "{words}: {}", ran.stderr);
        assert_harmless(words, &ran);
        assert!(ran.stderr.chars().count() < 700, "{words}: {}", ran.stderr);
        assert_eq!(ran.stderr.lines().count(), 1, "{words}: {}", ran.stderr);
    }
    assert!(!Path::new(&folder.path().join("out/volume.npz")).exists());
    // A mistake in the command line quotes what was typed.
    for typed in ["--\u{1b}[2J", "\u{1b}]0;title\u{7}"] {
        let ran = Outcome::of(command(folder.path(), [typed]).output().unwrap());
        assert_eq!(ran.status, 2, "{typed:?}: {}", ran.stderr);
        assert_harmless(&format!("{typed:?}"), &ran);
    }
}
