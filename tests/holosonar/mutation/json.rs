//! Changes to JSON documents, of glTF above all.

use crate::random::Random;
use serde_json::{Number, Value, json};

/// Words that readers of glTF know, and some that none should.
const WORDS: [&str; 14] = [
    "SCALAR",
    "VEC2",
    "VEC3",
    "MAT4",
    "BLEND",
    "MASK",
    "perspective",
    "KHR_mesh_quantization",
    "KHR_draco_mesh_compression",
    "data:application/octet-stream;base64,AAAAAAAAgD8AAIA/",
    "../../etc/passwd",
    "a%00b.bin",
    "\u{1b}[2J\u{202e}",
    "",
];

/// Whole numbers that are limits of something, and component types.
const NUMBERS: [u64; 14] =
    [0, 1, 2, 3, 4, 5, 255, 5123, 5125, 5126, (1 << 31) - 1, 1 << 32, 1 << 53, u64::MAX];

const FRACTIONS: [f64; 6] = [-1.0, 0.5, -0.0, 1e-300, 3.5e38, -1e308];

/// One to three changes to the nodes of a document; `None` if it is no JSON.
pub(super) fn change(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut document: Value = serde_json::from_slice(bytes).ok()?;
    for _ in 0..random.whole(1, 3) {
        let other = node(&mut document, random).clone();
        alter(node(&mut document, random), other, random);
    }
    serde_json::to_vec(&document).ok()
}

/// The same for the first chunk of a GLB, or bytes of the others; lengths are put right, mostly.
pub(super) fn change_glb(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
    let length = word(12)? as usize;
    let (document, rest) = bytes.get(20..)?.split_at_checked(length)?;
    let mut document = change(document, random)?;
    document.resize(document.len().next_multiple_of(4), b' ');
    let mut rest = rest.to_vec();
    if random.whole(0, 3) == 0 {
        rest = super::damage(&rest, random);
    }
    let all = 20 + document.len() + rest.len();
    let mut changed =
        [&bytes[..8], &(all as u32).to_le_bytes(), &(document.len() as u32).to_le_bytes()].concat();
    changed.extend(&bytes[16..20]);
    changed.extend(document);
    changed.extend(rest);
    if random.whole(0, 7) == 0 {
        let at = *random.one(&[8, 12, 16]);
        changed[at..at + 4].copy_from_slice(&(random.whole(0, 1 << 31) as u32).to_le_bytes());
    }
    Some(changed)
}

/// Some node, the root seldom.
fn node<'a>(root: &'a mut Value, random: &mut Random) -> &'a mut Value {
    let mut node = root;
    loop {
        let children = match &*node {
            Value::Array(items) => items.len(),
            Value::Object(members) => members.len(),
            _ => 0,
        };
        if children == 0 || random.whole(0, 9) == 0 {
            return node;
        }
        let child = random.whole(0, children - 1);
        node = match node {
            Value::Array(items) => &mut items[child],
            Value::Object(members) => members.values_mut().nth(child).expect("one of them"),
            _ => unreachable!("it has children"),
        };
    }
}

/// Changes a node as its type allows, or puts another in its place.
fn alter(node: &mut Value, other: Value, random: &mut Random) {
    match node {
        Value::Number(number) if random.whole(0, 7) > 0 => *number = another(number, random),
        Value::String(text) if random.whole(0, 7) > 0 => (*random.one(&WORDS)).clone_into(text),
        Value::Bool(value) => *value = !*value,
        Value::Array(items) if !items.is_empty() && random.whole(0, 7) > 0 => {
            let at = random.whole(0, items.len() - 1);
            match random.whole(0, 4) {
                0 => drop(items.remove(at)),
                1 => items.push(other),
                2 => items.truncate(at),
                3 => {
                    let last = items.len() - 1;
                    items.swap(at, last);
                }
                _ => {
                    let copies = random.whole(1, 40);
                    let item = items[at].clone();
                    items.extend(std::iter::repeat_n(item, copies));
                }
            }
        }
        Value::Object(members) if !members.is_empty() && random.whole(0, 7) > 0 => {
            let at = random.whole(0, members.len() - 1);
            let key = members.keys().nth(at).expect("one of them").clone();
            if random.whole(0, 1) == 0 {
                members.remove(&key);
            } else {
                members.insert(key, other);
            }
        }
        _ => {
            *node = match random.whole(0, 4) {
                0 => Value::Null,
                1 => json!([]),
                2 => json!({}),
                3 => json!(*random.one(&NUMBERS)),
                _ => other,
            }
        }
    }
}

/// A number beside this one, or a limit.
fn another(number: &Number, random: &mut Random) -> Number {
    match random.whole(0, 3) {
        0 => (*random.one(&NUMBERS)).into(),
        1 => Number::from_f64(*random.one(&FRACTIONS)).unwrap_or_else(|| 0.into()),
        2 => number.as_u64().unwrap_or(0).wrapping_add(random.whole(0, 2) as u64).wrapping_sub(1).into(),
        _ => random.whole(0, 20).into(),
    }
}
