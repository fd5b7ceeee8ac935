//! The paths that a Rust source file names, `use` trees unfolded, as seen from the crate's root.
//!
//! A small reader of Rust's words, not of its grammar: it skips comments, strings and characters, follows `mod name { ... }`, unfolds
//! the braces of `use` trees and resolves `crate`, `self` and `super`. It sees paths inside macros as well, where a
//! parser of items sees nothing but words, and takes nothing to build.

/// A word or a mark of the source; `::` is one mark.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Token {
    Word(String),
    Mark(char),
    PathSeparator,
}

/// The words and marks of a source text, without comments, strings and characters.
fn tokens(text: &str) -> Vec<Token> {
    let chars: Vec<char> = text.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut found = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        match at(i) {
            '/' if at(i + 1) == '/' => i += chars[i..].iter().take_while(|c| **c != '\n').count(),
            '/' if at(i + 1) == '*' => i = after_comment(&chars, i),
            '"' => i = after_string(&chars, i),
            // A character, or a lifetime, which is a mark and a word.
            '\'' if at(i + 1) == '\\' => {
                i += 3;
                i += chars[i.min(chars.len())..].iter().take_while(|c| **c != '\'').count() + 1;
            }
            '\'' if at(i + 2) == '\'' => i += 3,
            ':' if at(i + 1) == ':' => {
                found.push(Token::PathSeparator);
                i += 2;
            }
            c if is_word(c) => {
                let length = chars[i..].iter().take_while(|c| is_word(**c)).count();
                let word: String = chars[i..i + length].iter().collect();
                i += length;
                let hashes = chars[i..].iter().take_while(|c| **c == '#').count();
                if ["r", "br", "cr"].contains(&word.as_str()) && at(i + hashes) == '"' {
                    i = after_raw_string(&chars, i + hashes, hashes);
                } else if word == "r" && hashes == 1 {
                    i += 1; // `r#type` is the word `type`.
                } else if !(["b", "c"].contains(&word.as_str()) && ['"', '\''].contains(&at(i))) {
                    found.push(Token::Word(word));
                }
            }
            c => {
                if !c.is_whitespace() {
                    found.push(Token::Mark(c));
                }
                i += 1;
            }
        }
    }
    found
}

/// The place after a `/* comment */`, which may hold others.
fn after_comment(chars: &[char], start: usize) -> usize {
    let (mut i, mut depth) = (start, 0);
    while i < chars.len() {
        match (chars[i], chars.get(i + 1)) {
            ('/', Some('*')) => (i, depth) = (i + 2, depth + 1),
            ('*', Some('/')) => (i, depth) = (i + 2, depth - 1),
            _ => i += 1,
        }
        if depth == 0 {
            break;
        }
    }
    i
}

/// The place after a string that begins at `start`.
fn after_string(chars: &[char], start: usize) -> usize {
    let mut i = start + 1;
    while i < chars.len() && chars[i] != '"' {
        i += if chars[i] == '\\' { 2 } else { 1 };
    }
    i + 1
}

/// The place after a raw string whose opening quote is at `start`, after `hashes` hashes.
fn after_raw_string(chars: &[char], start: usize, hashes: usize) -> usize {
    let ends =
        |i: usize| chars[i] == '"' && chars[i + 1..].iter().take_while(|c| **c == '#').count() >= hashes;
    (start + 1..chars.len()).find(|i| ends(*i)).map_or(chars.len(), |i| i + 1 + hashes)
}

/// Every path of `text` that begins with `crate`, `self` or `super`, from the crate's root: `["wave", "geometry", "Geometry"]`. `module` is
/// the file's own, `["scene", "obj"]` for `src/scene/obj.rs`. `self` at the end of a `use` is the module itself, and a `*` is all its items.
/// A path that climbs beyond the root is `["super"]`.
pub(super) fn paths(text: &str, module: &[&str]) -> Vec<Vec<String>> {
    let tokens = tokens(text);
    let mut reader = Reader {
        tokens: &tokens,
        at: 0,
        module: module.iter().map(ToString::to_string).collect(),
        found: Vec::new(),
    };
    reader.read();
    reader.found
}

struct Reader<'a> {
    tokens: &'a [Token],
    at: usize,
    /// Where the reader is, modules within the file included.
    module: Vec<String>,
    found: Vec<Vec<String>>,
}

impl Reader<'_> {
    fn word(&self, ahead: usize) -> Option<&str> {
        match self.tokens.get(self.at + ahead) {
            Some(Token::Word(word)) => Some(word),
            _ => None,
        }
    }

    fn is(&self, ahead: usize, token: &Token) -> bool {
        self.tokens.get(self.at + ahead) == Some(token)
    }

    /// Reads to the end of the text.
    fn read(&mut self) {
        // For each open brace, whether it is a module's.
        let mut braces = Vec::new();
        while self.at < self.tokens.len() {
            let within_path = self.at > 0 && self.tokens[self.at - 1] == Token::PathSeparator;
            match self.word(0) {
                Some("mod") if self.word(1).is_some() && self.is(2, &Token::Mark('{')) => {
                    self.module.push(self.word(1).unwrap_or_default().to_owned());
                    braces.push(true);
                    self.at += 3;
                }
                Some("use") => {
                    self.at += 1;
                    // `impl Trait + use<'a>` is no import.
                    if !self.is(0, &Token::Mark('<')) {
                        self.tree(&[]);
                    }
                }
                Some("crate" | "self" | "super") if self.is(1, &Token::PathSeparator) && !within_path => {
                    self.tree(&[]);
                }
                _ => {
                    if self.is(0, &Token::Mark('{')) {
                        braces.push(false);
                    } else if self.is(0, &Token::Mark('}')) && braces.pop() == Some(true) {
                        self.module.pop();
                    }
                    self.at += 1;
                }
            }
        }
    }

    /// One tree: `a::b`, `a::{b, c::{self, d}}`, `a::*` or `a as b`, of which `start` has been read.
    fn tree(&mut self, start: &[String]) {
        let mut path = start.to_vec();
        // A leading `::` names another crate.
        if path.is_empty() && self.is(0, &Token::PathSeparator) {
            path.push("::".to_owned());
            self.at += 1;
        }
        loop {
            if let Some(word) = self.word(0) {
                path.push(word.to_owned());
                self.at += 1;
                if self.is(0, &Token::PathSeparator) {
                    self.at += 1;
                    continue;
                }
            } else if self.is(0, &Token::Mark('*')) {
                path.push("*".to_owned());
                self.at += 1;
            } else if self.is(0, &Token::Mark('{')) {
                self.at += 1;
                while self.at < self.tokens.len() && !self.is(0, &Token::Mark('}')) {
                    self.tree(&path);
                    if self.word(0) == Some("as") {
                        self.at += 2;
                    }
                    if self.is(0, &Token::Mark(',')) {
                        self.at += 1;
                    } else if !self.is(0, &Token::Mark('}')) {
                        return; // No tree: braces of something else.
                    }
                }
                self.at += 1;
                return;
            }
            break;
        }
        self.found.extend(self.resolved(&path));
    }

    /// A path from the root, if it begins with `crate`, `self` or `super`.
    fn resolved(&self, path: &[String]) -> Option<Vec<String>> {
        let mut full = match path.first()?.as_str() {
            "crate" => Vec::new(),
            "self" | "super" => self.module.clone(),
            _ => return None,
        };
        for segment in path {
            match segment.as_str() {
                "super" if full.pop().is_none() => return Some(vec!["super".to_owned()]),
                "crate" | "self" | "super" => {}
                name => full.push(name.to_owned()),
            }
        }
        Some(full)
    }
}

#[cfg(test)]
mod tests {
    use super::paths;

    /// The paths of a text in the module `scene::obj`, each as it would be typed.
    fn of(text: &str) -> Vec<String> {
        paths(text, &["scene", "obj"]).into_iter().map(|path| path.join("::")).collect()
    }

    #[test]
    fn trees_are_unfolded_however_deep_and_long() {
        assert_eq!(of("use crate::wave::Geometry;"), ["wave::Geometry"]);
        assert_eq!(
            of(
                "pub(crate) use crate::{\n    a,\n    b::{c, d::{self, e as f,}, super_e}, // g::h\n    i::*,\n};"
            ),
            ["a", "b::c", "b::d", "b::d::e", "b::super_e", "i::*"]
        );
        assert_eq!(of("use {crate::a, std::fs, self::b};"), ["a", "scene::obj::b"]);
        assert_eq!(of("pub(in crate::scene) use crate::a as b; use crate::c;"), ["scene", "a", "c"]);
        assert_eq!(of("use crate as root; use crate::*;"), ["", "*"]);
        assert_eq!(
            of("use std::{fs, io::{self, Read}}; use glam::DVec3; use ::log::info;"),
            Vec::<String>::new()
        );
    }

    #[test]
    fn super_is_followed_out_of_the_module_and_of_modules_within_the_file() {
        assert_eq!(
            of("use super::Scene; use super::super::plan::{self, memory};"),
            ["scene::Scene", "plan", "plan::memory"]
        );
        assert_eq!(of("use super::{super::{wave::A}, mtl};"), ["wave::A", "scene::mtl"]);
        assert_eq!(
            of(
                "mod tests { use super::*; fn f() { if x { super::super::g() } } mod deep { use super::super::super::super::plan; } }\nuse super::h;"
            ),
            ["scene::obj::*", "scene::g", "plan", "scene::h"]
        );
        assert_eq!(of("use super::super::super::up;"), ["super"]);
    }

    #[test]
    fn paths_are_seen_outside_of_imports_and_in_macros() {
        assert_eq!(
            of("fn f(a: &crate::plan::Plan<'_>) -> super::B { $crate::c!() }"),
            ["plan::Plan", "scene::B", "c"]
        );
        assert_eq!(of("matches!(x, crate::depth::Pick::First { n, .. })"), ["depth::Pick::First"]);
        assert_eq!(of("let s = self.crate_name; self::g::<u8>();"), ["scene::obj::g"]);
        assert_eq!(of("fn f<'a>(x: &'a str) -> impl Sized + use<'a> { crate::a(x) }"), ["a"]);
    }

    #[test]
    fn comments_strings_and_characters_name_nothing() {
        let text = r##"
            // use crate::a;
            /// [`crate::a`]
            /* use crate::a; /* crate::b */ crate::c */
            const A: &str = "use crate::a; \" crate::b";
            const B: &str = r#"crate::a " crate::b"#;
            const C: &[u8] = b"crate::a \\";
            const D: [char; 4] = ['"', '\'', '\u{22}', '{'];
            const E: u8 = b'"';
            use crate::last;
        "##;
        assert_eq!(of(text), ["last"]);
    }
}
