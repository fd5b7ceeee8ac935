//! `help`: commands explained by clap, and the chapters of the guide, which are [`crate::guide`] as well.

mod blocks;
mod roff;
mod text;

use super::Cli;
use super::terminal::{print, print_help};
use crate::error::{Error, Result};
use crate::guide::{CHAPTERS, Chapter};
use crate::text::{nearest, quoted};
use clap::{CommandFactory, Parser};
use std::fmt::Write;

/// The topic that lists the others.
const TOPICS: &str = "topics";

/// Prints the help of a command, a chapter, or the list of chapters; without words, the help of the program.
pub(super) fn help(words: &[String]) -> Result<()> {
    let topic = words.join("-").to_lowercase().replace('_', "-");
    if topic == TOPICS {
        return print(&topics());
    }
    if let Some(chapter) = CHAPTERS.iter().find(|chapter| chapter.topic() == topic) {
        let width = textwrap::termwidth().clamp(40, 100);
        return print(&text::render(&blocks::parse(chapter.text), width));
    }
    let commands = commands();
    if !topic.is_empty() && !commands.contains(&topic) {
        return Err(unknown(&topic, &commands));
    }
    // The same as for `COMMAND --help`.
    let typed = ["holosonar", &topic, "--help"].into_iter().filter(|word| !word.is_empty());
    match Cli::try_parse_from(typed) {
        Err(shown) if !shown.use_stderr() => print_help(&shown, &[]),
        _ => Err(unknown(&topic, &commands)),
    }
}

/// The chapters and their subjects, as listed at the end of `--help`.
pub(super) fn topics() -> String {
    let mut list = "Topics of the guide, shown by holosonar help TOPIC:\n".to_owned();
    for chapter in CHAPTERS {
        let _ = writeln!(list, "  {:12}  {}", chapter.topic(), chapter.about());
    }
    list
}

/// The manual pages of the chapters: file name and roff text.
pub(super) fn pages() -> impl Iterator<Item = (String, String)> {
    CHAPTERS.iter().map(|chapter| {
        let topic = chapter.topic();
        let page = roff::page(&topic, &chapter.about(), &blocks::parse(chapter.text));
        (format!("holosonar-guide-{topic}.7"), page)
    })
}

fn commands() -> Vec<String> {
    Cli::command().get_subcommands().map(|command| command.get_name().to_owned()).collect()
}

fn unknown(topic: &str, commands: &[String]) -> Error {
    let chapters: Vec<String> = CHAPTERS.iter().map(Chapter::topic).collect();
    let names = commands.iter().chain(&chapters).map(String::as_str);
    let names: Vec<&str> = names.chain([TOPICS]).collect();
    let meant = match nearest(topic, &names) {
        Some(name) => format!("did you mean `{name}`?"),
        None => "`holosonar help` lists the commands and topics".to_owned(),
    };
    Error::input("help", format!("there is no command or topic `{}`; {meant}", quoted(topic)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn every_file_of_the_guide_is_a_chapter() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/guide");
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let mut files: Vec<String> =
            entries.map(|path| path.file_stem().unwrap().to_str().unwrap().replace('_', "-")).collect();
        let mut topics: Vec<String> = CHAPTERS.iter().map(Chapter::topic).collect();
        files.sort();
        topics.sort();
        assert_eq!(files, topics);
        assert_eq!(CHAPTERS[0].about(), "every key of the run file, annotated");
    }

    #[test]
    fn no_topic_hides_a_command() {
        let commands = commands();
        for topic in CHAPTERS.iter().map(Chapter::topic).chain([TOPICS.to_owned()]) {
            assert!(!commands.contains(&topic), "{topic}");
        }
    }

    #[test]
    fn chapters_read_as_plain_text() {
        for chapter in CHAPTERS {
            let (topic, shown) = (chapter.topic(), text::render(&blocks::parse(chapter.text), 80));
            for markup in ["](", "```", "**", "|---", "\n# ", "\n## "] {
                // The annotated run file has comments of its own.
                if topic != "run-file" || !markup.contains('#') {
                    assert!(!shown.contains(markup), "{topic} has `{markup}`:\n{shown}");
                }
            }
        }
    }
}
