//! Parses the Markdown of a chapter into blocks, from which terminal and manual pages show the same text.
//!
//! Parts that only rustdoc or a browser needs are left out: link targets, hidden lines of Rust examples. Of a picture its
//! alternative text is shown.

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

/// The style of a run of text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum InlineStyle {
    Plain,
    Code,
    Strong,
    Emphasis,
}

/// Text in runs of one style.
pub(super) type Text = Vec<(InlineStyle, String)>;

/// A block of a chapter.
#[derive(Debug, PartialEq)]
pub(super) enum MarkdownBlock {
    /// A heading of level 1, 2, ..
    Heading(usize, Text),
    Paragraph(Text),
    /// An item of a list: the depth of the list, from 0, its bullet or number, and its text.
    Item(usize, String, Text),
    /// Preformatted lines.
    Code(String),
    /// Rows of cells; the first row is the header.
    Table(Vec<Vec<Text>>),
}

/// The text without its styles. Code among other words keeps its backticks.
pub(super) fn plain(text: &Text) -> String {
    if let [(_, run)] = &text[..] {
        return run.clone();
    }
    text.iter()
        .map(|(style, run)| if *style == InlineStyle::Code { format!("`{run}`") } else { run.clone() })
        .collect()
}

/// The blocks of a chapter.
pub(super) fn parse(markdown: &str) -> Vec<MarkdownBlock> {
    let mut reader = BlockParser::default();
    for event in Parser::new_ext(markdown, Options::ENABLE_TABLES) {
        reader.take(event);
    }
    reader.blocks
}

#[derive(Default)]
struct BlockParser {
    blocks: Vec<MarkdownBlock>,
    text: Text,
    styles: Vec<InlineStyle>,
    /// The number of the next item of each open list; `None` for bullets.
    lists: Vec<Option<u64>>,
    /// The bullet or number of an item whose text follows.
    bullet: Option<String>,
    rows: Vec<Vec<Text>>,
    code: Option<Code>,
}

/// An unfinished block of code.
struct Code {
    text: String,
    rust: bool,
}

impl BlockParser {
    fn take(&mut self, event: Event<'_>) {
        match event {
            Event::Start(tag) => self.start(tag),
            Event::End(tag) => self.end(tag),
            Event::Text(text) => match &mut self.code {
                Some(code) => code.text.push_str(&text),
                None => self.push(self.styles.last().copied().unwrap_or(InlineStyle::Plain), &text),
            },
            Event::Code(text) => self.push(InlineStyle::Code, &text),
            Event::SoftBreak | Event::HardBreak => self.push(InlineStyle::Plain, " "),
            _ => {}
        }
    }

    fn push(&mut self, style: InlineStyle, text: &str) {
        match self.text.last_mut() {
            Some((last, run)) if *last == style => run.push_str(text),
            _ => self.text.push((style, text.to_owned())),
        }
    }

    fn start(&mut self, tag: Tag<'_>) {
        match tag {
            Tag::Emphasis => self.styles.push(InlineStyle::Emphasis),
            Tag::Strong => self.styles.push(InlineStyle::Strong),
            Tag::Image { .. } => self.push(InlineStyle::Plain, "[Picture: "),
            Tag::List(first) => {
                // A list within an item: the text before it is the item's own.
                self.flush();
                self.lists.push(first);
            }
            Tag::Item => {
                let bullet = match self.lists.last_mut() {
                    Some(Some(number)) => {
                        *number += 1;
                        format!("{}.", *number - 1)
                    }
                    _ => "-".to_owned(),
                };
                self.bullet = Some(bullet);
            }
            Tag::CodeBlock(kind) => {
                self.flush();
                let rust = matches!(&kind, CodeBlockKind::Fenced(info) if info.starts_with("rust"));
                self.code = Some(Code { text: String::new(), rust });
            }
            Tag::Table(_) => self.rows.clear(),
            Tag::TableHead | Tag::TableRow => self.rows.push(Vec::new()),
            _ => {}
        }
    }

    fn end(&mut self, tag: TagEnd) {
        match tag {
            TagEnd::Emphasis | TagEnd::Strong => {
                self.styles.pop();
            }
            TagEnd::Image => self.push(InlineStyle::Plain, "]"),
            TagEnd::Heading(level) => {
                let text = std::mem::take(&mut self.text);
                self.blocks.push(MarkdownBlock::Heading(level as usize, text));
            }
            TagEnd::Paragraph | TagEnd::Item => self.flush(),
            TagEnd::List(_) => {
                self.lists.pop();
            }
            TagEnd::CodeBlock => {
                if let Some(Code { text, rust }) = self.code.take() {
                    let hidden = |line: &str| rust && (line == "#" || line.starts_with("# "));
                    let lines = text.lines().filter(|line| !hidden(line)).collect::<Vec<_>>();
                    self.blocks.push(MarkdownBlock::Code(lines.join("\n")));
                }
            }
            TagEnd::TableCell => {
                let text = std::mem::take(&mut self.text);
                if let Some(row) = self.rows.last_mut() {
                    row.push(text);
                }
            }
            TagEnd::Table => self.blocks.push(MarkdownBlock::Table(std::mem::take(&mut self.rows))),
            _ => {}
        }
    }

    /// Ends the current paragraph or item, if it has any text.
    fn flush(&mut self) {
        let text = std::mem::take(&mut self.text);
        if text.is_empty() {
            return;
        }
        let depth = self.lists.len().saturating_sub(1);
        self.blocks.push(match self.bullet.take() {
            Some(bullet) => MarkdownBlock::Item(depth, bullet, text),
            // A further paragraph of an item is indented like the first.
            None if !self.lists.is_empty() => MarkdownBlock::Item(depth, String::new(), text),
            None => MarkdownBlock::Paragraph(text),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_only_rustdoc_needs_is_left_out() {
        let blocks = parse(
            "# Title\n\nSee [files] and `a` *b*.\n\n![an x](y.png)\n\n```rust\n# use z;\nlet a = 1;\n#[test]\n```\n\n\
             [files]: files.md\n",
        );
        let run = |style, text: &str| (style, text.to_owned());
        assert_eq!(
            blocks,
            [
                MarkdownBlock::Heading(1, vec![run(InlineStyle::Plain, "Title")]),
                MarkdownBlock::Paragraph(vec![
                    run(InlineStyle::Plain, "See files and "),
                    run(InlineStyle::Code, "a"),
                    run(InlineStyle::Plain, " "),
                    run(InlineStyle::Emphasis, "b"),
                    run(InlineStyle::Plain, "."),
                ]),
                MarkdownBlock::Paragraph(vec![run(InlineStyle::Plain, "[Picture: an x]")]),
                MarkdownBlock::Code("let a = 1;\n#[test]".to_owned()),
            ]
        );
    }

    #[test]
    fn lists_and_tables_keep_their_order() {
        let blocks = parse("1. one\n2. two\n   - inner\n\n   more\n\n| a | b |\n|---|---|\n| `c` | d e |\n");
        let shown: Vec<String> = blocks
            .iter()
            .map(|block| match block {
                MarkdownBlock::Item(depth, bullet, text) => format!("{depth}{bullet}{}", plain(text)),
                MarkdownBlock::Table(rows) => rows.iter().flatten().map(plain).collect::<Vec<_>>().join("|"),
                other => format!("{other:?}"),
            })
            .collect();
        assert_eq!(shown, ["01.one", "02.two", "1-inner", "0more", "a|b|c|d e"]);
    }
}
