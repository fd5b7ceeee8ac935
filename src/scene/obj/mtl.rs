//! The two statements of an MTL file that matter for sound: `d` and `Tr`.
//!
//! Read here rather than by `tobj` 4.0, which reads the OBJ: it rejects the whole file for one bad colour and does not
//! read `Tr`.

use super::super::files::MeshFile;
use super::super::material::Material;
use crate::error::Result;
use crate::text::quoted;

/// The materials of an MTL file: opacity `d`, or 1 - `Tr`, or opaque.
///
/// # Errors
/// A `d` or `Tr` that is not a number in 0..1; the message names the line.
pub(super) fn parse(text: &str, file: MeshFile<'_>) -> Result<Vec<Material>> {
    let mut materials = Vec::new();
    let mut current: Option<Statements<'_>> = None;
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let share = || opacity(rest, keyword, file, i + 1);
        match (keyword, &mut current) {
            ("newmtl", _) => {
                let next = Statements { name: rest.trim(), d: None, tr: None };
                materials.extend(current.replace(next).map(|done| done.material(file)));
            }
            ("d", Some(material)) => material.d = Some(share()?),
            ("Tr", Some(material)) => material.tr = Some(share()?),
            _ => {}
        }
    }
    materials.extend(current.map(|done| done.material(file)));
    Ok(materials)
}

struct Statements<'a> {
    name: &'a str,
    d: Option<f64>,
    tr: Option<f64>,
}

impl Statements<'_> {
    fn material(&self, file: MeshFile<'_>) -> Material {
        match (self.d, self.tr) {
            (Some(d), tr) => {
                if let Some(tr) = tr.filter(|tr| (1.0 - tr - d).abs() > 1e-3) {
                    file.observer.warn(&format!(
                        "{}, material `{}`: d {d} and Tr {tr} contradict each other (Tr should be 1 - d); d is used",
                        file.path.display(),
                        quoted(self.name)
                    ));
                }
                // Nearly every exporter writes `d 1`; that counts as the default, not as information.
                if d == 1.0 {
                    Material::opaque(self.name)
                } else {
                    Material::of_opacity(self.name, d, "MTL d")
                }
            }
            (None, Some(tr)) if tr > 0.0 => Material::of_opacity(self.name, 1.0 - tr, "MTL Tr"),
            _ => Material::opaque(self.name),
        }
    }
}

/// The number of a `d` or `Tr` statement; `d -halo 0.5` has it last.
fn opacity(rest: &str, keyword: &str, file: MeshFile<'_>, line: usize) -> Result<f64> {
    let word = rest.split('#').next().unwrap_or_default().split_whitespace().next_back().unwrap_or_default();
    match word.parse() {
        Ok(value) if (0.0..=1.0).contains(&value) => Ok(value),
        _ => {
            let problem = format!("`{keyword} {}` must give an opacity from 0 to 1", quoted(rest.trim()));
            Err(file.refused_at(format_args!("line {line}"), problem))
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::super::LoadOptions;
    use super::*;
    use crate::named::{Warnings, assert_names};
    use std::path::Path;

    /// The materials and the warnings.
    fn parse_text(text: &str) -> (Result<Vec<Material>>, Vec<String>) {
        let (options, warnings) = (LoadOptions::default(), Warnings::default());
        let file = MeshFile { path: Path::new("x.mtl"), options: &options, observer: &warnings };
        (parse(text, file), warnings.list())
    }

    #[test]
    fn opacity_comes_from_d_then_tr() {
        let text = "# x\nnewmtl a b\nKd 0.1 0.2\nd 0.4\nnewmtl t\n  Tr 0.25 # clear\nnewmtl h\nd -halo 0.5\r\nnewmtl o\nd 1.0\nTr 1\nKe";
        let (materials, warnings) = parse_text(text);
        let materials = materials.unwrap();
        let seen: Vec<_> =
            materials.iter().map(|m| (m.name.as_str(), m.reflectance, m.source.as_str())).collect();
        assert_eq!(
            seen,
            [
                ("a b", 0.99, "MTL d, as glass"),
                ("t", 0.99, "MTL Tr, as glass"),
                ("h", 0.99, "MTL d, as glass"),
                ("o", 1.0, "default")
            ]
        );
        assert_eq!(materials[0].transmittance, 0.0);
        assert_names(&warnings[0], &["x.mtl", "material `o`", "d 1", "Tr 1"]);
    }

    #[test]
    fn bad_opacities_name_their_line() {
        for bad in ["d", "d x", "d 1.5", "Tr -0.1", "d nan"] {
            let message = parse_text(&format!("newmtl a\n{bad}")).0.unwrap_err().to_string();
            assert_names(message, &["x.mtl", "line 2", "0 to 1"]);
        }
    }
}
