//! Blocks as a manual page of section 7.

use super::blocks::{InlineStyle, MarkdownBlock, Text, plain};
use super::text::table;
use clap_mangen::roff::{Inline, Roff, bold, italic, roman};

/// Columns of a table on a manual page.
const WIDTH: usize = 74;

/// The page of a chapter, in roff.
pub(super) fn page(name: &str, about: &str, blocks: &[MarkdownBlock]) -> String {
    let mut roff = Roff::new();
    let version = concat!("holosonar ", env!("CARGO_PKG_VERSION"));
    roff.control("TH", [&*format!("holosonar-guide-{name}"), "7", "\"\"", version, "The guide of holosonar"]);
    roff.control("SH", ["NAME"]);
    roff.text([roman(format!("holosonar-guide-{name} - {about}"))]);
    for block in blocks {
        match block {
            // The title of the chapter becomes the description of the page.
            MarkdownBlock::Heading(1, _) => {
                roff.control("SH", ["DESCRIPTION"]);
            }
            MarkdownBlock::Heading(level, text) => {
                roff.control(if *level == 2 { "SH" } else { "SS" }, [&*plain(text)]);
            }
            MarkdownBlock::Paragraph(text) => {
                roff.control("PP", []).text(inlines(text));
            }
            MarkdownBlock::Item(depth, bullet, text) => {
                let bullet = match bullet.as_str() {
                    "-" => "\u{2022}",
                    "" => "\u{a0}",
                    number => number,
                };
                let indent = (4 + 4 * depth).to_string();
                roff.control("IP", [bullet, &*indent]).text(inlines(text));
            }
            MarkdownBlock::Code(code) => preformatted(&mut roff, code.lines()),
            MarkdownBlock::Table(rows) => {
                preformatted(&mut roff, table(rows, WIDTH).iter().map(|line| line.trim_end()));
            }
        }
    }
    roff.render()
}

fn inlines(text: &Text) -> Vec<Inline> {
    text.iter()
        .map(|(style, run)| match style {
            InlineStyle::Plain => roman(run),
            InlineStyle::Code | InlineStyle::Strong => bold(run),
            InlineStyle::Emphasis => italic(run),
        })
        .collect()
}

/// Lines that are neither filled nor joined.
fn preformatted<'l>(roff: &mut Roff, lines: impl Iterator<Item = &'l str>) {
    roff.control("PP", []).control("RS", ["4"]).control("nf", []);
    for line in lines {
        roff.text([roman(line)]);
    }
    roff.control("fi", []).control("RE", []);
}
