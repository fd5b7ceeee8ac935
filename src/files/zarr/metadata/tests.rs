#![allow(clippy::unwrap_used)]
use super::*;
use crate::named::assert_names;
use serde_json::json;

fn plain() -> Value {
    json!({"zarr_format": 3, "node_type": "array", "shape": [5, 7], "data_type": "float32", "fill_value": 0.0,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [4, 6]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}], "attributes": {}})
}

fn sharding(inner: &Value, index: &Value) -> Value {
    json!([{"name": "sharding_indexed", "configuration":
        {"chunk_shape": [2, 3], "codecs": inner, "index_codecs": index, "index_location": "start"}}])
}

#[test]
fn chunks_and_shards_are_understood() {
    let meta = ArrayMeta::parse(&plain()).unwrap();
    assert_eq!((&meta.file, &meta.chunk, meta.index), (&meta.chunk, &vec![4, 6], None));
    assert_eq!(meta.keys.name(&[1, 2]), "c/1/2");
    let mut sharded = plain();
    let bytes = json!({"name": "bytes", "configuration": {"endian": "big"}});
    sharded["codecs"] = sharding(&json!([bytes, "crc32c"]), &json!([bytes]));
    sharded["chunk_key_encoding"] = json!("v2");
    sharded["extra"] = json!({"must_understand": false});
    let meta = ArrayMeta::parse(&sharded).unwrap();
    assert_eq!((meta.chunk, meta.codecs, meta.dtype.big_endian), (vec![2, 3], vec![Codec::Crc32c], true));
    assert_eq!(meta.index, Some(IndexCoding { big_endian: true, crc32c: false, at_end: false }));
    assert_eq!((meta.keys.name(&[1, 2]), meta.keys.name(&[])), ("1.2".into(), "0".into()));
}

#[test]
fn fill_values_are_numbers_words_or_bits() {
    let dtype = |name: &str, big| dtype(&json!(name), big).unwrap();
    for (value, kind, big, expected) in [
        (json!(1.5), "float32", false, 1.5_f32.to_le_bytes().to_vec()),
        (json!("-Infinity"), "float64", true, f64::NEG_INFINITY.to_be_bytes().to_vec()),
        (json!("0x7fc00001"), "float32", false, vec![1, 0, 0xc0, 0x7f]),
        (json!([0, "NaN"]), "complex64", false, [[0; 4], f32::NAN.to_le_bytes()].concat()),
        (json!(-2), "int16", true, vec![0xff, 0xfe]),
        (json!(u64::MAX), "uint64", false, vec![255; 8]),
    ] {
        assert_eq!(fill_value(&value, dtype(kind, big)).unwrap(), expected, "{value}");
    }
    for (value, kind) in
        [(json!("x"), "float32"), (json!(null), "int8"), (json!(256), "uint8"), (json!([0]), "complex64")]
    {
        assert_names(fill_value(&value, dtype(kind, false)).unwrap_err(), &["fill_value"]);
    }
}

#[test]
fn anything_else_is_refused_by_name() {
    let bytes = json!({"name": "bytes", "configuration": {"endian": "little"}});
    for (key, value, word) in [
        ("node_type", json!("group"), "array"),
        ("shape", json!([-1]), "`shape`"),
        ("shape", json!([1e30]), "`shape`"),
        ("data_type", json!("float16"), "`float16`"),
        ("data_type", json!({"name": "struct"}), "struct"),
        ("chunk_grid", json!({"name": "rectangular"}), "rectangular"),
        ("chunk_grid", json!({"name": "regular", "configuration": {"chunk_shape": [0, 1]}}), "chunk_shape"),
        ("chunk_grid", json!({"name": "regular", "configuration": {"chunk_shape": [1]}}), "chunk_shape"),
        (
            "chunk_grid",
            json!({"name": "regular", "configuration": {"chunk_shape": [4_294_967_296_u64, 4_294_967_296_u64]}}),
            "chunk_shape",
        ),
        ("chunk_key_encoding", json!({"name": "suffix"}), "suffix"),
        (
            "chunk_key_encoding",
            json!({"name": "default", "configuration": {"separator": "/../"}}),
            "separator",
        ),
        ("codecs", json!([bytes, "blosc"]), "`blosc`"),
        ("codecs", json!(["transpose", bytes]), "`transpose`"),
        ("codecs", json!([]), "`bytes`"),
        ("codecs", json!([bytes, "gzip", "gzip", "gzip", "gzip", "gzip"]), "4 codecs"),
        (
            "codecs",
            sharding(&sharding(&json!([bytes]), &json!([bytes])), &json!([bytes])),
            "sharding_indexed",
        ),
        ("codecs", sharding(&json!([bytes]), &json!([bytes, "gzip"])), "index"),
        ("storage_transformers", json!(["x"]), "transformers"),
        ("fill_value", json!("zero"), "fill_value"),
        ("extra", json!(1), "`extra`"),
    ] {
        let mut json = plain();
        json[key] = value;
        assert_names(ArrayMeta::parse(&json).unwrap_err(), &[word]);
    }
    let mut uneven = plain();
    uneven["codecs"] = sharding(&json!([bytes]), &json!([bytes]));
    uneven["chunk_grid"]["configuration"]["chunk_shape"] = json!([3, 6]);
    assert_names(ArrayMeta::parse(&uneven).unwrap_err(), &["multiples"]);
}
