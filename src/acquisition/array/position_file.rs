//! Microphone positions from a file: CSV with the header `x,y,z`, or the XML of Acoular's array geometries.
//!
//! ```xml
//! <?xml version="1.0" encoding="utf-8"?>
//! <MicArray name="array_64">
//!   <pos Name="Point 1" x="0.152" y="0.1" z="0"/>
//! </MicArray>
//! ```
//!
//! Of XML this reads what such files hold: tags with attributes in quotes, comments, declarations. Nothing is looked up
//! elsewhere, and every loop moves forward, so a file can only be refused, never endless.

use super::MicArray;
use crate::error::{Error, Result};
use crate::files::extension;
use crate::reflectors::csv::read_columns;
use glam::DVec3;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes beyond which an XML file is taken for something else: half a million microphones.
const LARGEST: u64 = 64 << 20;

impl MicArray {
    /// Reads positions in m from a `.csv` (header `x,y,z`) or from Acoular's `.xml`. They count as scattered, whatever
    /// their order.
    ///
    /// # Errors
    /// A missing file, one that is neither, or one without positions; the message names the line.
    pub fn read(path: &Path) -> Result<Self> {
        let positions = if extension(path) == "xml" {
            read_xml(path)?
        } else {
            read_columns(path, ["x", "y", "z"])?.into_iter().map(DVec3::from_array).collect()
        };
        Self::from_positions(positions).map_err(|error| error.at(path.display()))
    }
}

fn read_xml(path: &Path) -> Result<Vec<DVec3>> {
    let reading = |error| Error::reading(path, error);
    let mut bytes = Vec::new();
    File::open(path).map_err(reading)?.take(LARGEST + 1).read_to_end(&mut bytes).map_err(reading)?;
    if bytes.len() as u64 > LARGEST {
        return Err(Error::input(path.display(), "is larger than 64 MiB; no array has a geometry so long"));
    }
    let text = String::from_utf8(bytes).map_err(|_| {
        Error::input(path.display(), "is not UTF-8 text; an Acoular array geometry was expected")
    })?;
    let positions = positions(&text).map_err(|(byte, problem)| {
        let line = 1 + text[..byte.min(text.len())].matches('\n').count();
        Error::input(format!("{}:{line}", path.display()), problem)
    })?;
    if positions.is_empty() {
        return Err(Error::input(
            path.display(),
            "holds no microphones; at least one <pos .../> was expected",
        ));
    }
    Ok(positions)
}

/// What is wrong at which byte.
type Fault = (usize, String);

/// What stands in angle brackets, with the byte it begins at.
struct Tag<'t> {
    at: usize,
    name: &'t str,
    attributes: Vec<(&'t str, &'t str)>,
}

/// The positions of every `<pos>` within `<MicArray>`.
fn positions(text: &str) -> std::result::Result<Vec<DVec3>, Fault> {
    let mut found = Vec::new();
    let mut inside = false;
    let mut at = 0;
    while let Some(tag) = next_tag(text, &mut at)? {
        match tag.name {
            "MicArray" => inside = true,
            "/MicArray" => return Ok(found),
            _ if !inside => {
                return Err((
                    tag.at,
                    format!(
                        "<{}> was found where <MicArray> was expected: this is no Acoular array",
                        short(tag.name)
                    ),
                ));
            }
            "pos" => found.push(position(&tag)?),
            // Acoular looks for <pos> alone; so do we.
            _ => {}
        }
    }
    let problem = if inside { "the file ends before </MicArray>" } else { "holds no <MicArray>" };
    Err((text.len(), problem.to_owned()))
}

/// x, y and z of a `<pos>`, m.
fn position(tag: &Tag) -> std::result::Result<DVec3, Fault> {
    let number = |name: &str| {
        let typed = tag.attributes.iter().find(|(key, _)| *key == name).map(|(_, value)| *value);
        let typed = typed
            .ok_or_else(|| (tag.at, format!("<pos> lacks `{name}`; x, y and z in metres were expected")))?;
        typed.trim().parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(|| {
            (
                tag.at,
                format!("`{name}` of <pos> is \"{}\"; a finite number of metres was expected", short(typed)),
            )
        })
    };
    Ok(DVec3::new(number("x")?, number("y")?, number("z")?))
}

/// The next tag from byte `at` on, comments and declarations aside, and `at` moved behind it.
fn next_tag<'t>(text: &'t str, at: &mut usize) -> std::result::Result<Option<Tag<'t>>, Fault> {
    loop {
        let Some(open) = text[*at..].find('<').map(|i| *at + i) else { return Ok(None) };
        let rest = &text[open..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>"), ("<!", ">")];
        if let Some((begin, end)) = skipped.iter().find(|(begin, _)| rest.starts_with(begin)) {
            let length = rest[begin.len()..]
                .find(end)
                .ok_or_else(|| (open, format!("`{begin}` has no `{end}` behind it")))?;
            *at = open + begin.len() + length + end.len();
            continue;
        }
        return tag(text, open, at).map(Some);
    }
}

/// The tag that opens at byte `open`.
fn tag<'t>(text: &'t str, open: usize, at: &mut usize) -> std::result::Result<Tag<'t>, Fault> {
    let cut = || (open, "a tag is cut short; `>` was expected".to_owned());
    let name_ends = |c: char| c.is_whitespace() || c == '>' || c == '=';
    let mut rest = &text[open + 1..];
    let name = &rest[..rest.find(name_ends).ok_or_else(cut)?];
    rest = &rest[name.len()..];
    // `<pos/>` has nothing between its name and its end.
    let name = name.strip_suffix('/').unwrap_or(name);
    let mut attributes = Vec::new();
    loop {
        rest = rest.trim_start();
        if let Some(behind) = rest.strip_prefix("/>").or_else(|| rest.strip_prefix('>')) {
            *at = text.len() - behind.len();
            return Ok(Tag { at: open, name, attributes });
        }
        let key = &rest[..rest.find(name_ends).ok_or_else(cut)?];
        let value = rest[key.len()..].trim_start().strip_prefix('=').map(str::trim_start);
        let quoted =
            value.and_then(|value| Some((value, value.chars().next().filter(|c| matches!(c, '"' | '\''))?)));
        let Some((value, quote)) = quoted.filter(|_| !key.is_empty()) else {
            return Err((
                text.len() - rest.len(),
                format!("`{}` in <{}> was expected to be name=\"value\"", short(key), short(name)),
            ));
        };
        let length = value[1..].find(quote).ok_or_else(cut)?;
        attributes.push((key, &value[1..=length]));
        rest = &value[length + 2..];
    }
}

/// The beginning of what may be long.
fn short(text: &str) -> String {
    text.chars().take(40).flat_map(char::escape_debug).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    const ACOULAR: &str = "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<!-- two > <pos/> -->\n<MicArray name=\"two\">\n  \
                           <pos Name=\"Point 1\" x=\"0.152\" y='-1e-1' z=\" 0 \"/>\n\t<pos z=\"0.5\"\n y=\"2\" x = \"1\" \
                           Name=\"a > b\" ></pos>\n</MicArray>\n";

    #[test]
    fn acoulars_geometries_are_read() {
        let read = positions(ACOULAR).unwrap();
        assert_eq!(read, [DVec3::new(0.152, -0.1, 0.0), DVec3::new(1.0, 2.0, 0.5)]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("two.XML");
        std::fs::write(&path, ACOULAR).unwrap();
        assert_eq!(MicArray::read(&path).unwrap().positions(), read);
        let csv = folder.path().join("two.csv");
        std::fs::write(&csv, "x,y,z\n0.152,-0.1,0\n1,2,0.5\n").unwrap();
        assert_eq!(MicArray::read(&csv).unwrap().positions(), read);
    }

    #[test]
    fn what_is_no_geometry_is_refused_by_its_line() {
        let folder = tempfile::tempdir().unwrap();
        for (text, parts) in [
            ("", &["bad.xml", "no <MicArray>"][..]),
            ("<MicArray>\n</MicArray>", &["holds no microphones"]),
            ("<MicArray>\n<pos x='1' y='2'/>\n</MicArray>", &["bad.xml:2", "lacks `z`"]),
            ("<MicArray>\n<pos x='1' y='2' z='nan'/></MicArray>", &[":2", "a finite number"]),
            ("<MicArray>\n<pos x=1 y='2' z='3'/></MicArray>", &[":2", "name=\"value\""]),
            ("<MicArray>\n\n<pos x='1' y='2' z='3'/>", &[":3", "ends before </MicArray>"]),
            ("<MicArray><pos x='1", &["cut short"]),
            ("<MicArray><pos x='1' y='2' z='3' ", &["cut short"]),
            ("<svg><pos x='1' y='2' z='3'/></svg>", &["<svg> was found where <MicArray>"]),
            ("<!-- never closed", &["`-->`"]),
            ("<MicArray><pos x='1e30' y='0' z='0'/></MicArray>", &["lies beyond"]),
        ] {
            let path = folder.path().join("bad.xml");
            std::fs::write(&path, text).unwrap();
            let message = MicArray::read(&path).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{part:?} is not in: {message}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn nothing_makes_it_panic(cut in 0..ACOULAR.len(), at in 0..ACOULAR.len(), put in "\\PC{0,6}|[<>='\"/ ]{1,6}") {
            let mut text = ACOULAR.to_owned();
            text.insert_str(at, &put);
            let _ = positions(&text);
            let end = (cut..=text.len()).find(|i| text.is_char_boundary(*i)).unwrap_or(0);
            let _ = positions(&text[..end]);
        }

        #[test]
        fn no_text_makes_it_panic(text in "([<>='\"/!?\\-x ]|pos|MicArray|é){0,60}") {
            let _ = positions(&text);
        }
    }
}
