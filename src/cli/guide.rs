//! `help`: commands explained by clap, and the chapters of the guide, which are [`crate::guide`] as well.

mod blocks;
mod roff;
mod text;

use super::{Cli, terminal::print};
use crate::config::nearest;
use crate::error::{Error, Result};
use clap::{CommandFactory, Parser};
use std::fmt::Write;

/// A chapter of the guide.
struct Chapter {
    /// Its topic.
    name: &'static str,
    /// Its subject, in a few words.
    about: &'static str,
    /// Its Markdown.
    text: &'static str,
}

macro_rules! chapter {
    ($name:literal, $about:literal, $($text:expr),+) => {
        Chapter { name: $name, about: $about, text: concat!($($text),+) }
    };
}

/// The chapters, in reading order.
const CHAPTERS: [Chapter; 12] = [
    chapter!(
        "run-file",
        "every key of the run file, annotated",
        include_str!("../guide/run_file.md"),
        "\n```toml\n",
        include_str!("../config/annotated.toml"),
        "```\n"
    ),
    chapter!("files", "every file that is read or written", include_str!("../guide/files.md")),
    chapter!("measured", "from a recording to an image", include_str!("../guide/measured.md")),
    chapter!("design", "choosing array, band and grid before measuring", include_str!("../guide/design.md")),
    chapter!(
        "physics",
        "what is simulated, and what it does to an image",
        include_str!("../guide/physics.md")
    ),
    chapter!("method", "how the volume is computed, and how exactly", include_str!("../guide/method.md")),
    chapter!("metrics", "how a depth map is scored", include_str!("../guide/metrics.md")),
    chapter!("paper", "the paper's table and figures, reproduced", include_str!("../guide/paper.md")),
    chapter!(
        "interruption",
        "resuming, limits of memory, identical results",
        include_str!("../guide/interruption.md")
    ),
    chapter!(
        "performance",
        "what was measured, and how to measure it",
        include_str!("../guide/performance.md")
    ),
    chapter!("limits", "what is not modelled, read or possible", include_str!("../guide/limits.md")),
    chapter!(
        "code",
        "where things are in the source, and how to add to it",
        include_str!("../guide/code.md")
    ),
];

/// The topic that lists the others.
const TOPICS: &str = "topics";

/// Prints the help of a command, a chapter, or the list of chapters; without words, the help of the program.
pub(super) fn help(words: &[String]) -> Result<()> {
    let topic = words.join("-").to_lowercase().replace('_', "-");
    if topic == TOPICS {
        return print(&topics());
    }
    if let Some(chapter) = CHAPTERS.iter().find(|chapter| chapter.name == topic) {
        let width = textwrap::termwidth().clamp(40, 100);
        return print(&text::render(&blocks::parse(chapter.text), width));
    }
    let commands = commands();
    if !topic.is_empty() && !commands.contains(&topic) {
        return Err(unknown(&topic, &commands));
    }
    // Clap prints the same as for `COMMAND --help`, in colour if the terminal has it.
    let typed = ["holosonar", &topic, "--help"].into_iter().filter(|word| !word.is_empty());
    match Cli::try_parse_from(typed) {
        Err(shown) if !shown.use_stderr() => match shown.print() {
            Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
                Err(Error::io("standard output", format!("cannot be written: {e}")))
            }
            _ => Ok(()),
        },
        _ => Err(unknown(&topic, &commands)),
    }
}

/// The chapters and their subjects, as listed at the end of `--help`.
pub(super) fn topics() -> String {
    let mut list = "Topics of the guide, shown by holosonar help TOPIC:\n".to_owned();
    for Chapter { name, about, .. } in &CHAPTERS {
        let _ = writeln!(list, "  {name:12}  {about}");
    }
    list
}

/// The manual pages of the chapters: file name and roff text.
pub(super) fn pages() -> impl Iterator<Item = (String, String)> {
    CHAPTERS.iter().map(|Chapter { name, about, text }| {
        (format!("holosonar-guide-{name}.7"), roff::page(name, about, &blocks::parse(text)))
    })
}

fn commands() -> Vec<String> {
    Cli::command().get_subcommands().map(|command| command.get_name().to_owned()).collect()
}

fn unknown(topic: &str, commands: &[String]) -> Error {
    let names = commands.iter().map(String::as_str).chain(CHAPTERS.iter().map(|chapter| chapter.name));
    let names: Vec<&str> = names.chain([TOPICS]).collect();
    let meant = match nearest(topic, &names) {
        Some(name) => format!("did you mean `{name}`?"),
        None => "`holosonar help` lists the commands and topics".to_owned(),
    };
    Error::input("help", format!("there is no command or topic `{}`; {meant}", topic.escape_debug()))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::Path;

    #[test]
    fn the_library_and_the_command_line_have_the_same_chapters() {
        let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let module = fs::read_to_string(src.join("guide.rs")).unwrap();
        let (_, list) = module.split_once("\nchapters! {\n").unwrap();
        // Each chapter is a line of its subject, and one that begins with its name.
        let lines: Vec<&str> = list.lines().map(str::trim).collect();
        let library: Vec<(String, &str)> = lines
            .windows(2)
            .filter_map(|pair| {
                let about = pair[0].strip_prefix("/// ")?.strip_suffix('.')?;
                Some((about.to_lowercase(), pair[1].split_once(':')?.0))
            })
            .collect();
        let here: Vec<String> = CHAPTERS.iter().map(|chapter| chapter.name.replace('-', "_")).collect();
        let about = |chapter: &Chapter| chapter.about.to_lowercase();
        let named: Vec<(String, &str)> =
            CHAPTERS.iter().zip(&here).map(|(chapter, name)| (about(chapter), name.as_str())).collect();
        assert_eq!(library, named);
        let mut files: Vec<String> = fs::read_dir(src.join("guide"))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        files.sort();
        let mut expected: Vec<String> = here.iter().map(|name| format!("{name}.md")).collect();
        expected.sort();
        assert_eq!(files, expected);
    }

    #[test]
    fn no_topic_hides_a_command() {
        let commands = commands();
        for chapter in &CHAPTERS {
            assert!(!commands.iter().any(|command| command == chapter.name), "{}", chapter.name);
        }
        assert!(!commands.iter().any(|command| command == TOPICS));
    }

    #[test]
    fn chapters_read_as_plain_text() {
        for Chapter { name, text, .. } in &CHAPTERS {
            let shown = text::render(&blocks::parse(text), 80);
            for markup in ["](", "```", "**", "|---", "\n# ", "\n## "] {
                // The annotated run file has comments of its own.
                if *name != "run-file" || !markup.contains('#') {
                    assert!(!shown.contains(markup), "{name} has `{markup}`:\n{shown}");
                }
            }
        }
    }
}
