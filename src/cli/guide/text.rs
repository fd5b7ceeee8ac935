//! Blocks as plain text of a given width.

use super::blocks::{MarkdownBlock, Text, plain};
use textwrap::core::display_width;
use textwrap::{Options, WordSplitter, wrap};

/// Spaces between the columns of a table.
const GAP: usize = 2;

/// Minimum width of a table column that is narrowed.
const MIN_WIDTH: usize = 12;

/// A chapter as text; its lines, except code, are at most `width` columns wide.
pub(super) fn render(blocks: &[MarkdownBlock], width: usize) -> String {
    let mut shown = String::new();
    let mut after_item = false;
    for block in blocks {
        let is_item = matches!(block, MarkdownBlock::Item(..));
        // Items follow one another without a blank line.
        if !(shown.is_empty() || is_item && after_item) {
            shown.push('\n');
        }
        after_item = is_item;
        for line in lines(block, width) {
            shown.push_str(line.trim_end());
            shown.push('\n');
        }
    }
    shown
}

fn lines(block: &MarkdownBlock, width: usize) -> Vec<String> {
    match block {
        MarkdownBlock::Heading(1, text) => vec![plain(text).to_uppercase()],
        MarkdownBlock::Heading(_, text) => {
            let heading = plain(text);
            let line = "-".repeat(display_width(&heading));
            vec![heading, line]
        }
        MarkdownBlock::Paragraph(text) => wrapped(&plain(text), width),
        MarkdownBlock::Item(depth, bullet, text) => {
            let indent = " ".repeat(2 + 2 * depth);
            let after = " ".repeat(display_width(bullet).max(1) + 1);
            let options = options(width);
            let first =
                if bullet.is_empty() { format!("{indent}{after}") } else { format!("{indent}{bullet} ") };
            let next = format!("{indent}{after}");
            let options = options.initial_indent(&first).subsequent_indent(&next);
            wrap(&plain(text), options).into_iter().map(String::from).collect()
        }
        MarkdownBlock::Code(code) => code.lines().map(|line| format!("    {line}")).collect(),
        MarkdownBlock::Table(rows) => table(rows, width),
    }
}

/// Words are not hyphenated, so that paths and keys remain intact.
fn options<'o>(width: usize) -> Options<'o> {
    Options::new(width).word_splitter(WordSplitter::NoHyphenation)
}

fn wrapped(text: &str, width: usize) -> Vec<String> {
    wrap(text, options(width)).into_iter().map(String::from).collect()
}

/// A table in columns; the widest are wrapped if the table does not fit.
pub(super) fn table(rows: &[Vec<Text>], width: usize) -> Vec<String> {
    let cells: Vec<Vec<String>> = rows.iter().map(|row| row.iter().map(plain).collect()).collect();
    let columns = cells.iter().map(Vec::len).max().unwrap_or(0);
    let widest = |column: usize| {
        cells.iter().filter_map(|row| row.get(column)).map(|cell| display_width(cell)).max().unwrap_or(0)
    };
    let mut widths: Vec<usize> = (0..columns).map(widest).collect();
    let available = width.saturating_sub(GAP * columns.saturating_sub(1));
    while widths.iter().sum::<usize>() > available {
        let Some(widest) = widths.iter_mut().max().filter(|widest| **widest > MIN_WIDTH) else { break };
        *widest -= 1;
    }
    // Rows are separated by blank lines if any cell is wrapped.
    let separated =
        cells.iter().any(|row| row.iter().zip(&widths).any(|(cell, width)| display_width(cell) > *width));
    let mut lines = Vec::new();
    for (number, row) in cells.iter().enumerate() {
        let parts: Vec<Vec<String>> =
            row.iter().zip(&widths).map(|(cell, width)| wrapped(cell, *width)).collect();
        let height = parts.iter().map(Vec::len).max().unwrap_or(0);
        if separated && number > 1 {
            lines.push(String::new());
        }
        for line in 0..height {
            let shown = parts.iter().zip(&widths).map(|(part, width)| {
                let text = part.get(line).map_or("", String::as_str);
                format!("{text}{}", " ".repeat(width.saturating_sub(display_width(text))))
            });
            lines.push(shown.collect::<Vec<_>>().join(&" ".repeat(GAP)));
        }
        if number == 0 {
            let rules: Vec<String> = widths.iter().map(|width| "-".repeat(*width)).collect();
            lines.push(rules.join(&" ".repeat(GAP)));
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::super::blocks::parse;
    use super::*;

    #[test]
    fn only_code_is_wider_than_the_given_width() {
        let long = "word ".repeat(40);
        let text = format!(
            "# T\n\n{long}\n\n- {long}\n- b\n\n| key | what |\n|---|---|\n| a | {long} |\n| p̂ | short |\n"
        );
        let shown = render(&parse(&text), 50);
        assert!(shown.lines().all(|line| display_width(line) <= 50), "{shown}");
        assert_eq!(shown.matches("word").count(), 120, "{shown}");
        assert!(
            shown.contains("\n  - word") && shown.contains("\n    word") && shown.contains("\n  - b\n"),
            "{shown}"
        );
    }

    #[test]
    fn columns_line_up() {
        let shown = render(&parse("| a | b |\n|---|---|\n| x | 1 |\n| longer | 2 |\n"), 80);
        assert_eq!(shown, "a       b\n------  -\nx       1\nlonger  2\n");
    }
}
