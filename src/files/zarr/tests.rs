#![allow(clippy::unwrap_used)]
use super::*;
use crate::named::assert_names;
use num_complex::Complex32;
use serde_json::json;
use std::path::PathBuf;

const LIMIT: u64 = 1 << 24;

/// Numbers with no two alike.
fn numbers(shape: &[usize]) -> Vec<Complex32> {
    (0..shape.iter().product()).map(|i| Complex32::new(i as f32, 0.5)).collect()
}

/// A store with one array, `a`.
fn store(folder: &Path, shape: &[usize], zip: bool) -> PathBuf {
    let path = folder.join(format!("{shape:?}-{zip}.zarr"));
    let names = ["a", "b", "c", "d"];
    let spec = ArraySpec { dimensions: &names[..shape.len()], attributes: json!({}), zip };
    write_group(&path, &json!({ MARK: {}, META: { "sound_speed": 343.0 } })).unwrap();
    let mut writer = ZarrWriter::create::<Complex32>(&path.join("a"), shape, &spec).unwrap();
    writer.append(&numbers(shape)).unwrap();
    writer.finish();
    path
}

/// A store whose array `a` has this metadata, and these files of chunks.
fn foreign(folder: &Path, json: &Value, chunks: &[(&str, Vec<u8>)]) -> PathBuf {
    let path = folder.join("foreign.zarr");
    let _ = fs::remove_dir_all(&path);
    write_group(&path, &json!({})).unwrap();
    fs::create_dir(path.join("a")).unwrap();
    fs::write(path.join("a/zarr.json"), json.to_string()).unwrap();
    for (name, bytes) in chunks {
        let chunk = path.join("a").join(name);
        fs::create_dir_all(chunk.parent().unwrap()).unwrap();
        fs::write(chunk, bytes).unwrap();
    }
    path
}

fn metadata(shape: &Value, chunk: &Value, kind: &str) -> Value {
    json!({"zarr_format": 3, "node_type": "array", "shape": shape, "data_type": kind, "fill_value": 7,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}}, "attributes": {},
        "chunk_key_encoding": {"name": "default"},
        "codecs": [{"name": "bytes", "configuration": {"endian": "big"}}]})
}

fn big_endian(numbers: &[i16]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_be_bytes()).collect()
}

#[test]
fn arrays_of_every_shape_are_read_as_they_were_written() {
    let folder = tempfile::tempdir().unwrap();
    for shape in [&[1, 1][..], &[70, 5], &[3, 9000], &[33, 65, 130], &[2, 40, 3, 70], &[64, 64, 64]] {
        for zip in [false, true] {
            let store = ZarrStore::open(&store(folder.path(), shape, zip), LIMIT).unwrap();
            let found = store.complex("a").unwrap();
            assert_eq!((&found.shape[..], store.names().collect::<Vec<_>>()), (shape, vec!["a"]));
            assert!(found.data == numbers(shape), "{shape:?}");
            let mut blocks = Vec::new();
            store
                .complex_blocks("a", 37, |block| {
                    assert!(block.len() <= 37);
                    blocks.extend_from_slice(block);
                    Ok(())
                })
                .unwrap();
            assert!(blocks == found.data, "{shape:?}");
        }
    }
}

#[test]
fn plain_chunks_of_other_programs_are_read_and_missing_ones_filled() {
    let folder = tempfile::tempdir().unwrap();
    // Of five numbers in chunks of two the last is alone, and the middle chunk is missing.
    let chunks = [("c/0", big_endian(&[1, -2])), ("c/2", big_endian(&[5, 99]))];
    let path = foreign(folder.path(), &metadata(&json!([5]), &json!([2]), "int16"), &chunks);
    let found = ZarrStore::open(&path, LIMIT).unwrap().f64("a").unwrap();
    assert_eq!(found.data, [1.0, -2.0, 7.0, 7.0, 5.0]);
    // Two axes, and names as of version 2.
    let mut json = metadata(&json!([2, 3]), &json!([1, 2]), "int16");
    json["chunk_key_encoding"] = json!({"name": "v2", "configuration": {"separator": "."}});
    let chunks = [("0.0", big_endian(&[1, 2])), ("0.1", big_endian(&[3, 0])), ("1.1", big_endian(&[6, 0]))];
    let found = ZarrStore::open(&foreign(folder.path(), &json, &chunks), LIMIT).unwrap().f64("a").unwrap();
    assert_eq!((found.data, found.shape), (vec![1.0, 2.0, 3.0, 7.0, 7.0, 6.0], vec![2, 3]));
}

/// With which other programs compress if they are not asked.
#[test]
fn zstd_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut json = metadata(&json!([4]), &json!([4]), "int16");
    json["codecs"] = json!([{"name": "bytes", "configuration": {"endian": "big"}},
        {"name": "zstd", "configuration": {"level": 0, "checksum": false}}]);
    // A frame of one raw block.
    let content = big_endian(&[1, 2, 3, 4]);
    let frame = [&[0x28, 0xb5, 0x2f, 0xfd, 0x20, 8, (8 << 3) | 1, 0, 0][..], &content].concat();
    let read = |frame: Vec<u8>| {
        ZarrStore::open(&foreign(folder.path(), &json, &[("c/0", frame)]), LIMIT).unwrap().f64("a")
    };
    assert_eq!(read(frame.clone()).unwrap().data, [1.0, 2.0, 3.0, 4.0]);
    for at in 0..frame.len() {
        let _ = read(frame[..at].to_vec()).unwrap_err();
    }
}

#[test]
fn what_would_take_too_much_is_refused_before_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    for (shape, chunk, words) in [
        (json!([4_000_000]), json!([1000]), &["bytes, more than the limit"][..]),
        // A small array in one large chunk.
        (json!([2]), json!([100_000_000]), &["more than the limit"]),
        (json!([3_000_000_000_u64, 3_000_000_000_u64, 3_000_000_000_u64]), json!([1, 1, 1]), &["limit"]),
        (json!([1_500_000]), json!([1]), &["pieces", "1048576"]),
        (json!([]), json!([]), &["single number"]),
    ] {
        let path = foreign(folder.path(), &metadata(&shape, &chunk, "int16"), &[]);
        let error = ZarrStore::open(&path, LIMIT).unwrap().f64("a").unwrap_err();
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), &["foreign.zarr", "array `a`"]);
        assert_names(error.to_string(), words);
    }
    // Where there is no limit, what overflows is refused all the same.
    for (shape, chunk) in
        [(json!([4]), json!([u64::MAX / 2])), (json!([u64::MAX / 4, 3]), json!([1_u64 << 40, 3]))]
    {
        let path = foreign(folder.path(), &metadata(&shape, &chunk, "int16"), &[]);
        let found = ZarrStore::open(&path, u64::MAX).unwrap().complex_blocks("a", 10, |_| Ok(()));
        assert_eq!(found.unwrap_err().exit_status(), 2);
    }
    // In blocks it need not fit.
    let path = foreign(folder.path(), &metadata(&json!([4_000_000]), &json!([4000]), "int16"), &[]);
    let mut count = 0;
    let store = ZarrStore::open(&path, 1 << 20).unwrap();
    store
        .complex_blocks("a", 1000, |block| {
            count += block.len();
            Ok(())
        })
        .unwrap();
    assert_eq!(count, 4_000_000);
}

#[test]
fn what_is_no_store_of_version_3_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zarr");
    let open = || ZarrStore::open(&path, LIMIT).unwrap_err().to_string();
    assert_names(open(), &["a.zarr", "no such file"]);
    fs::write(&path, "x").unwrap();
    assert_names(open(), &["a.zarr", "is a file"]);
    fs::remove_file(&path).unwrap();
    fs::create_dir(&path).unwrap();
    assert_names(open(), &["no zarr.json"]);
    fs::write(path.join(".zgroup"), "{}").unwrap();
    assert_names(open(), &["version 2", "migrate"]);
    for (text, word) in [
        ("{", "JSON"),
        ("[]", "`zarr_format`"),
        (r#"{"zarr_format": 4}"#, "version 4"),
        (r#"{"zarr_format": 3, "node_type": "array"}"#, "no group"),
    ] {
        fs::write(path.join("zarr.json"), text).unwrap();
        assert_names(open(), &["a.zarr", word]);
    }
    fs::write(path.join("zarr.json"), "[".repeat(100_000)).unwrap();
    assert_names(open(), &["JSON"]);
    write_group(&path, &json!({})).unwrap();
    let store = ZarrStore::open(&path, LIMIT).unwrap();
    assert_names(store.f64("z").unwrap_err().to_string(), &["array `z`", "missing", "no arrays"]);
    assert_names(store.text("meta").unwrap_err().to_string(), &["attribute `meta`"]);
}

#[cfg(unix)]
#[test]
fn links_within_a_store_are_not_followed() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let path = store(folder.path(), &[3, 4], true);
    let chunk = path.join("a/c/0/0");
    fs::rename(&chunk, folder.path().join("elsewhere")).unwrap();
    symlink(folder.path().join("elsewhere"), &chunk).unwrap();
    let opened = ZarrStore::open(&path, LIMIT).unwrap();
    assert_names(opened.complex("a").unwrap_err().to_string(), &["array `a`", "link"]);
    assert_names(opened.fingerprint().unwrap_err().to_string(), &["link"]);
    symlink(path.join("a"), path.join("b")).unwrap();
    assert_names(ZarrStore::open(&path, LIMIT).unwrap().complex("b").unwrap_err().to_string(), &["link"]);
    // The store itself may be reached by one.
    fs::remove_file(&chunk).unwrap();
    symlink(&path, folder.path().join("by_link.zarr")).unwrap();
    ZarrStore::open(&folder.path().join("by_link.zarr"), LIMIT).unwrap().complex("a").unwrap();
}

#[test]
fn damaged_shards_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    for zip in [false, true] {
        let path = store(folder.path(), &[3, 4, 130], zip);
        let shard = path.join("a/c/0/0/0");
        let whole = fs::read(&shard).unwrap();
        let read = || ZarrStore::open(&path, LIMIT).unwrap().complex("a");
        for length in (0..whole.len()).step_by(61) {
            fs::write(&shard, &whole[..length]).unwrap();
            assert_names(read().unwrap_err().to_string(), &["array `a`", "chunk c/0/0/0"]);
        }
        let mut unnoticed = 0;
        for at in (0..whole.len()).step_by(11) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x10;
            fs::write(&shard, &damaged).unwrap();
            unnoticed += usize::from(read().is_ok());
        }
        // In gzip, the time and the system in the head of each chunk mean nothing.
        assert!(unnoticed * 100 < whole.len(), "{unnoticed} of {}", whole.len());
        fs::write(&shard, &whole).unwrap();
        read().unwrap();
    }
}

#[test]
fn an_index_may_say_anything() {
    let folder = tempfile::tempdir().unwrap();
    let path = store(folder.path(), &[3, 4, 130], true);
    let shard = path.join("a/c/0/0/0");
    let whole = fs::read(&shard).unwrap();
    let chunks = 3;
    let body = whole.len() - (16 * chunks + 4);
    for place in [(u64::MAX - 1, 5), (0, u64::MAX - 1), (5, 0), (body as u64, 60), (0, whole.len() as u64)] {
        let bytes = [&whole[..body], &codec::encode_index(&vec![place; chunks])].concat();
        fs::write(&shard, bytes).unwrap();
        let found = ZarrStore::open(&path, LIMIT).unwrap().complex("a").map(drop);
        assert!(found.is_err_and(|error| error.exit_status() == 2), "{place:?}");
    }
    // A chunk that is missing is filled.
    let bytes = [&whole[..body], &codec::encode_index(&[(u64::MAX, u64::MAX); 3])].concat();
    fs::write(&shard, bytes).unwrap();
    let found = ZarrStore::open(&path, LIMIT).unwrap().complex("a").unwrap();
    assert!(found.data.iter().all(|number| *number == Complex32::ZERO));
}

#[test]
fn a_fingerprint_knows_every_byte() {
    let folder = tempfile::tempdir().unwrap();
    let path = store(folder.path(), &[3, 4], true);
    let print = || ZarrStore::open(&path, LIMIT).unwrap().fingerprint().unwrap();
    let first = print();
    assert_eq!((first.lines().count(), print()), (3, first.clone()));
    let shard = path.join("a/c/0/0");
    let mut bytes = fs::read(&shard).unwrap();
    bytes[20] ^= 1;
    fs::write(&shard, bytes).unwrap();
    assert_ne!(print(), first);
}
