//! Files of one position each, whose names say where: `scan/x{x}_y{y}.s2p`.

use super::{ImportOptions, Positions, place_of_key};
use crate::acquisition::MicArray;
use crate::error::{Error, Result};
use crate::text::quoted;
use glam::DVec3;
use std::fs;
use std::path::{Path, PathBuf};

/// The most files of a folder that are looked at.
const MOST_FILES: usize = 1 << 20;

/// The longest number in a name, bytes.
const LONGEST_NUMBER: usize = 24;

/// What a name may hold in braces; numbers with a unit first.
const NUMBERS: [&str; 5] = ["x", "y", "ix", "iy", "i"];

/// A part of a pattern: text, or one of [`NUMBERS`].
#[derive(Debug, PartialEq)]
enum NamePart {
    Text(String),
    Number(usize),
}

/// Whether a path is a pattern.
pub(super) fn is_pattern(path: &Path) -> bool {
    path.to_string_lossy().contains('{')
}

/// The parts of a file name.
fn parts(name: &str) -> std::result::Result<Vec<NamePart>, String> {
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some((text, after)) = rest.split_once('{') {
        let (word, end) = after.split_once('}').ok_or("has a `{` without `}`")?;
        let number = NUMBERS.iter().position(|number| *number == word).ok_or_else(|| {
            format!("has `{{{}}}`; {{x}}, {{y}}, {{ix}}, {{iy}} and {{i}} are known", quoted(word))
        })?;
        if parts.contains(&NamePart::Number(number)) {
            return Err(format!("has `{{{word}}}` twice"));
        }
        if !text.is_empty() {
            parts.push(NamePart::Text(text.to_owned()));
        } else if matches!(parts.last(), Some(NamePart::Number(_))) {
            return Err("has two numbers with nothing between them".into());
        }
        parts.push(NamePart::Number(number));
        rest = end;
    }
    parts.push(NamePart::Text(rest.to_owned()));
    let has = |numbers: &[usize]| numbers.iter().any(|n| parts.contains(&NamePart::Number(*n)));
    match [has(&[0, 1]), has(&[2, 3]), has(&[4])].iter().filter(|kind| **kind).count() {
        1 => Ok(parts),
        0 => Err("has no {x}, {y}, {ix}, {iy} or {i}".into()),
        _ => Err("mixes {x}, {y} with {ix}, {iy} or {i}; one kind was expected".into()),
    }
}

/// The numbers of a name that fits; NaN for those that the pattern does not have.
fn numbers(name: &str, parts: &[NamePart]) -> Option<[f64; 5]> {
    match parts {
        [] => name.is_empty().then_some([f64::NAN; 5]),
        [NamePart::Text(text), rest @ ..] => numbers(name.strip_prefix(text.as_str())?, rest),
        [NamePart::Number(which), rest @ ..] => {
            let run =
                name.bytes().take(LONGEST_NUMBER).take_while(|b| b.is_ascii_digit() || b"+-.".contains(b));
            (1..=run.count()).rev().find_map(|end| {
                let number = name[..end].parse::<f64>().ok()?;
                let mut found = numbers(&name[end..], rest)?;
                found[*which] = number;
                Some(found)
            })
        }
    }
}

/// Names of the files in the folder of a path.
fn files_of(folder: &Path) -> Result<Vec<String>> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let reading = |error| Error::reading(folder, error);
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(reading)? {
        names.extend(entry.map_err(reading)?.file_name().into_string());
        if names.len() > MOST_FILES {
            return Err(Error::input(folder.display(), format!("holds more than {MOST_FILES} files")));
        }
    }
    names.sort();
    Ok(names)
}

/// The refusal of a folder, which proposes a pattern.
pub(super) fn refuse_folder(folder: &Path) -> Error {
    let names = files_of(folder).unwrap_or_default();
    let name = names.iter().find(|name| !name.starts_with('.'));
    let seen = name.map_or_else(String::new, |name| format!("; its first file is {}", quoted(name)));
    let problem = format!(
        "is a folder{seen}; give the pattern of its files' names, with {{x}} and {{y}} for positions ({{ix}} and {{iy}} for \
         indices) in place of numbers, as in {}",
        folder.join("x{x}_y{y}.s2p").display()
    );
    Error::input(folder.display(), problem)
}

/// The files of a pattern in the order of the microphones, and where these are.
///
/// # Errors
/// A pattern that is none, no files that fit, positions that are twice or not there, numbers without a unit, indices without
/// an array.
pub(super) fn find(
    pattern: &Path,
    options: &ImportOptions,
    guesses: &mut Vec<String>,
) -> Result<(Vec<PathBuf>, Positions)> {
    let refuse = |problem: String| Error::input(pattern.display(), problem);
    let folder = pattern.parent().unwrap_or(Path::new(""));
    if is_pattern(folder) {
        return Err(refuse("has a number in the name of a folder; only names of files may have some".into()));
    }
    let name = pattern.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let parts = parts(name).map_err(refuse)?;
    let names = files_of(folder)?;
    let mut found: Vec<([f64; 5], &String)> =
        names.iter().filter_map(|name| Some((numbers(name, &parts)?, name))).collect();
    if found.is_empty() {
        let seen =
            names.first().map_or("it is empty".to_owned(), |name| format!("it holds {}", quoted(name)));
        return Err(refuse(format!("fits no file of its folder; {seen}")));
    }
    let has = |number: usize| parts.contains(&NamePart::Number(number));
    if !(has(0) || has(1)) {
        return by_index(&found, folder, options, guesses, &refuse);
    }
    if options.formulas.is_some() {
        let problem = "are given by formulas and by the numbers in the files' names; keep one of them, or name files by {ix} and {iy}";
        return Err(Error::input(place_of_key("positions"), problem));
    }
    let unit = options.name_unit.ok_or_else(|| {
        let problem = "is missing: the numbers in the files' names have no unit; give m, cm, mm, in or ft";
        Error::input(place_of_key("name_unit"), problem)
    })?;
    let coordinate = |value: f64| if value.is_nan() { 0.0 } else { value * unit.metres() };
    found.sort_by(|(a, _), (b, _)| {
        let key = |numbers: &[f64; 5]| [coordinate(numbers[1]), coordinate(numbers[0])];
        let (a, b) = (key(a), key(b));
        a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
    });
    let mut points: Vec<DVec3> =
        found.iter().map(|(n, _)| DVec3::new(coordinate(n[0]), coordinate(n[1]), 0.0)).collect();
    if let Some(twice) = points.windows(2).position(|pair| pair[0] == pair[1]) {
        let problem = format!("has two files of one position, {} and {}", found[twice].1, found[twice + 1].1);
        return Err(refuse(problem));
    }
    if let Some(centre) = options.centre {
        let (low, high) =
            points.iter().fold((points[0], points[0]), |(low, high), p| (low.min(*p), high.max(*p)));
        for point in &mut points {
            *point += centre - low.midpoint(high);
        }
    } else {
        guesses
            .push("positions: the numbers in the names are x and y in the array's frame, z = 0".to_owned());
    }
    let columns = points.iter().take_while(|point| point.y == points[0].y).count();
    let in_rows = points.chunks(columns).all(|row| {
        row.len() == columns && row.iter().zip(&points).all(|(p, first)| p.x == first.x && p.y == row[0].y)
    });
    let rows = [points.len() / columns, columns];
    let array = if in_rows { MicArray::from_rows(rows, points) } else { MicArray::from_positions(points) };
    let array = array.map_err(|error| error.at(pattern.display()))?;
    let files = found.iter().map(|(_, name)| folder.join(name)).collect();
    Ok((files, Positions { array, rows: in_rows.then_some(rows), from: "names of files" }))
}

/// The files by the indices of their microphones in `[array]`.
fn by_index(
    found: &[([f64; 5], &String)],
    folder: &Path,
    options: &ImportOptions,
    guesses: &mut Vec<String>,
    refuse: &dyn Fn(String) -> Error,
) -> Result<(Vec<PathBuf>, Positions)> {
    let positions = Positions::typed(options)?;
    let [n_y, n_x] = positions.rows.unwrap_or([1, positions.array.len()]);
    let indices: Vec<[f64; 2]> =
        found
            .iter()
            .map(|(n, _)| {
                if n[4].is_nan() {
                    [n[3], n[2]].map(|i| if i.is_nan() { 0.0 } else { i })
                } else {
                    [0.0, n[4]]
                }
            })
            .collect();
    let in_list = found.iter().any(|(n, _)| !n[4].is_nan());
    let counts = if in_list { [1, positions.array.len()] } else { [n_y, n_x] };
    // Counted from 1 if no index is 0 and the last one would be too large.
    let first: Vec<f64> = (0..2)
        .map(|axis| {
            let all = || indices.iter().map(|i| i[axis]);
            let from_one = all().all(|i| i >= 1.0) && all().any(|i| i == counts[axis] as f64);
            f64::from(u8::from(from_one))
        })
        .collect();
    if first.contains(&1.0) {
        guesses.push("indices in the names are counted from 1".to_owned());
    }
    let mut files: Vec<Option<PathBuf>> = vec![None; positions.array.len()];
    for (at, (_, name)) in indices.iter().zip(found) {
        let [y, x] = [at[0] - first[0], at[1] - first[1]];
        let within = [y, x].iter().zip(counts).all(|(i, n)| i.fract() == 0.0 && *i >= 0.0 && *i < n as f64);
        if !within {
            let problem = format!(
                "has a file beyond [array], {}; there are {} x {} microphones",
                quoted(name),
                counts[1],
                counts[0]
            );
            return Err(refuse(problem));
        }
        let slot = &mut files[y as usize * counts[1] + x as usize];
        if let Some(other) = slot.replace(folder.join(name)) {
            return Err(refuse(format!(
                "has two files of one microphone, {} and {}",
                other.display(),
                quoted(name)
            )));
        }
    }
    let missing = files.iter().position(Option::is_none);
    if let Some(missing) = missing {
        let problem = format!(
            "has {} files for the {} microphones of [array]; one without a file has the indices x {}, y {}, counted from 0",
            found.len(),
            files.len(),
            missing % counts[1],
            missing / counts[1]
        );
        return Err(refuse(problem));
    }
    Ok((files.into_iter().flatten().collect(), positions))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn names_are_taken_apart() {
        let xy = parts("scan_x{x}-y{y}.s2p").unwrap();
        let found = numbers("scan_x-12.5-y-3.s2p", &xy).unwrap();
        assert_eq!(found[..2], [-12.5, -3.0]);
        for name in ["scan_x-y3.s2p", "scan_x1-y2.s2p.bak", "can_x1-y2.s2p", "scan_x1e3-y2.s2p"] {
            assert_eq!(numbers(name, &xy), None, "{name}");
        }
        assert_eq!(numbers("7_9", &parts("{ix}_{iy}").unwrap()).unwrap()[2..4], [7.0, 9.0]);
        for bad in ["{x", "{z}", "{x}{y}", "{x}_{x}", "{x}_{iy}", "x"] {
            assert!(parts(bad).is_err(), "{bad}");
        }
        let long = "1".repeat(1000);
        assert_eq!(numbers(&long, &xy), None);
    }
}
