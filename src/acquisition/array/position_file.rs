//! Microphone positions from a file: CSV with the header `x,y,z`, or the XML of Acoular's array geometries.
//!
//! ```xml
//! <?xml version="1.0" encoding="utf-8"?>
//! <MicArray name="array_64">
//!   <pos Name="Point 1" x="0.152" y="0.1" z="0"/>
//! </MicArray>
//! ```
//!
//! `quick-xml` reads the XML tag by tag: it loads nothing else, and neither time nor memory grows faster than the file.
//! With `roxmltree` 0.21, 50 kB of nested namespaces took 11 s, and the time grows with the cube of their number.

use super::MicArray;
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result, gib};
use crate::files::{extension, open_input};
use crate::reflectors::csv::Table;
use crate::text::quoted;
use glam::DVec3;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::io::Read;
use std::path::Path;

/// Maximum size of an XML file, bytes: about half a million microphones.
const LARGEST: u64 = 64 << 20;

/// The attributes of a `<pos>` that give its position.
const AXES: [&str; 3] = ["x", "y", "z"];

impl MicArray {
    /// Reads positions in m from a `.csv` (header `x,y,z`) or from Acoular's `.xml`. They are treated as scattered,
    /// whatever their order.
    ///
    /// # Errors
    /// A missing file, a file of another format, or one without positions; the message names the line.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_within(path, None)
    }

    /// [`MicArray::read`] of positions that take at most `memory` bytes.
    ///
    /// # Errors
    /// As [`MicArray::read`]; more positions than fit.
    pub fn read_within(path: &Path, memory: Option<u64>) -> Result<Self> {
        Self::from_positions(read_positions(path, memory)?).map_err(|error| error.at(path.display()))
    }
}

/// Positions in m of a `.csv` or `.xml` file, in its order.
pub(in crate::acquisition) fn read_positions(path: &Path, memory: Option<u64>) -> Result<Vec<DVec3>> {
    if extension(path) == "xml" { read_xml(path, memory) } else { read_csv(path, memory) }
}

fn read_csv(path: &Path, memory: Option<u64>) -> Result<Vec<DVec3>> {
    let table = Table::open(path, AXES)?;
    let rows = table.fitting_rows(size_of::<DVec3>() as u64, memory)?;
    let mut positions = try_with_capacity(rows).ok_or_else(|| {
        Error::out_of_memory(format!("{}: {rows} positions do not fit in memory; give fewer", path.display()))
    })?;
    table.read(|position| positions.push(DVec3::from_array(position)))?;
    Ok(positions)
}

fn read_xml(path: &Path, memory: Option<u64>) -> Result<Vec<DVec3>> {
    let reading = |error| Error::reading(path, error);
    let mut bytes = Vec::new();
    let file = open_input(path)?;
    // The text, and the positions, of which each takes more bytes as text.
    let length = file.metadata().map_err(reading)?.len().min(LARGEST);
    if let Some(most) = memory.filter(|most| 2 * length > *most) {
        let problem = format!(
            "takes {} of memory to read, and {} may be used here (--memory sets another limit); give fewer microphones, or \
             a CSV",
            gib(2 * length),
            gib(most)
        );
        return Err(Error::input(path.display(), problem));
    }
    file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(reading)?;
    if bytes.len() as u64 > LARGEST {
        return Err(Error::input(
            path.display(),
            "is larger than 64 MiB, the maximum size of an array geometry",
        ));
    }
    let text = String::from_utf8(bytes).map_err(|_| {
        Error::input(path.display(), "is not UTF-8 text; an Acoular array geometry was expected")
    })?;
    // Places are counted without the mark of byte order, which the parser skips.
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let positions = positions(text).map_err(|(byte, problem)| {
        let line = 1 + text.bytes().take(byte).filter(|byte| *byte == b'\n').count();
        Error::input(format!("{}:{line}", path.display()), problem)
    })?;
    if positions.is_empty() {
        return Err(Error::input(path.display(), "has no microphones; at least one <pos .../> was expected"));
    }
    Ok(positions)
}

/// The positions of every `<pos>` within `<MicArray>`; an error is a byte offset and what is wrong there.
fn positions(text: &str) -> std::result::Result<Vec<DVec3>, (usize, String)> {
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let mut found = Vec::new();
    let mut inside = false;
    loop {
        let at = reader.buffer_position() as usize;
        let event = reader.read_event();
        let event = event.map_err(|error| {
            (
                reader.error_position() as usize,
                format!("is not well-formed XML: {}", quoted(&error.to_string())),
            )
        })?;
        match event {
            Event::Start(tag) => match tag.name().as_ref() {
                "MicArray" => inside = true,
                name if !inside => {
                    let name = quoted(name);
                    let problem =
                        format!("<{name}> was found, <MicArray> was expected: this is not an Acoular array");
                    return Err((at, problem));
                }
                "pos" => found.push(position(&tag).map_err(|problem| (at, problem))?),
                // Acoular ignores every other element, too.
                _ => {}
            },
            Event::End(tag) if tag.name().as_ref() == "MicArray" => return Ok(found),
            Event::Eof => {
                let problem = if inside { "the file ends before </MicArray>" } else { "has no <MicArray>" };
                return Err((text.len(), problem.to_owned()));
            }
            _ => {}
        }
    }
}

/// x, y and z of a `<pos>`, m.
fn position(tag: &BytesStart) -> std::result::Result<DVec3, String> {
    let mut position = [None; 3];
    // Checking for duplicate names would take time that grows with the square of their number.
    for attribute in tag.attributes().with_checks(false) {
        let attribute = attribute
            .map_err(|error| format!("an attribute of <pos> is not of the form name=\"value\" ({error})"))?;
        let name = attribute.key.as_ref();
        let Some(axis) = AXES.iter().position(|axis| *axis == name) else { continue };
        let number = attribute.value.trim().parse().ok().filter(|value: &f64| value.is_finite());
        position[axis] = Some(number.ok_or_else(|| {
            format!(
                "`{name}` of <pos> is \"{}\"; a finite number of metres was expected",
                quoted(&attribute.value)
            )
        })?);
    }
    match position.iter().position(Option::is_none) {
        Some(axis) => Err(format!("<pos> has no `{}`; x, y and z in metres were expected", AXES[axis])),
        None => Ok(DVec3::from_array(position.map(Option::unwrap_or_default))),
    }
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
    fn a_file_that_is_not_a_geometry_is_refused_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        for (text, parts) in [
            ("", &["bad.xml", "<MicArray>"][..]),
            ("<MicArray>\n</MicArray>", &["<pos .../>"]),
            ("<MicArray>\n<pos x='1' y='2'/>\n</MicArray>", &["bad.xml:2", "no `z`"]),
            ("<MicArray>\n<pos x='1' y='2' z='nan'/></MicArray>", &[":2", "a finite number"]),
            ("<MicArray>\n<pos x=1 y='2' z='3'/></MicArray>", &[":2", "name=\"value\""]),
            ("<MicArray>\n\n<pos x='1' y='2' z='3'/>", &[":3", "ends before </MicArray>"]),
            ("<MicArray>\n<pos x='1", &[":2", "not closed"]),
            ("<MicArray>\n<pos x='1' y='2' z='3' ", &[":2", "not closed", "`>`"]),
            ("<MicArray>\n<pos x='1' y='2' z='3'>\n</MicArray>", &[":3", "`</pos>`"]),
            ("<svg><pos x='1' y='2' z='3'/></svg>", &["<svg>", "<MicArray>"]),
            ("<!-- never closed", &["`-->`"]),
            ("<MicArray/>", &["<pos .../>"]),
            ("<MicArray><pos x='1e30' y='0' z='0'/></MicArray>", &["beyond"]),
        ] {
            let path = folder.path().join("bad.xml");
            std::fs::write(&path, text).unwrap();
            let message = MicArray::read(&path).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{part:?} is not in: {message}");
            }
        }
    }

    #[test]
    fn files_are_held_to_the_memory_there_is() {
        let folder = tempfile::tempdir().unwrap();
        let [csv, xml] = ["a.csv", "a.xml"].map(|name| folder.path().join(name));
        std::fs::write(&csv, format!("x,y,z\n{}", "0,0,0\n".repeat(1000))).unwrap();
        std::fs::write(&xml, ACOULAR).unwrap();
        // A header and a row take as many bytes: the file may have 1001 rows.
        for (path, enough) in [(&csv, 1001 * 24), (&xml, 2 * ACOULAR.len() as u64)] {
            assert!(MicArray::read_within(path, Some(enough)).is_ok());
            let refused = MicArray::read_within(path, Some(enough - 1)).unwrap_err();
            assert_eq!(refused.exit_status(), 2);
            assert!(refused.to_string().contains("--memory"), "{refused}");
        }
    }

    #[test]
    fn time_grows_no_faster_than_the_file() {
        let names: Vec<_> = (0..100_000).map(|i| format!(" a{i}='' xmlns:b{i}='c{i}'")).collect();
        let names = names.concat();
        let text = format!("<MicArray><pos{names} x='1' y='2' z='3'/></MicArray>");
        assert_eq!(positions(&text).unwrap(), [DVec3::new(1.0, 2.0, 3.0)]);
        let deep: Vec<_> = (0..100_000).map(|i| format!("<a{i} xmlns:b{i}='c{i}'>")).collect();
        assert!(positions(&format!("<MicArray>{}", deep.concat())).is_err());
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
