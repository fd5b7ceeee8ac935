//! glTF's extensions that move surfaces: quantized positions and instances.
#![allow(clippy::unwrap_used)]

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD_NO_PAD;
use glam::DVec3;
use serde_json::{Value, json};

use super::gltf_tests::{document, load, load_with, raw, refused, set, with};
use super::{MaterialRule, Scene};
use crate::named::assert_names;

/// One triangle whose corners are `values`, three at a time, as numbers of `size` bytes in steps of `stride`.
fn quantized(values: &[i32; 9], size: usize, stride: usize, kind: u32, normalized: bool) -> Value {
    let mut bytes = Vec::new();
    for corner in values.chunks(3) {
        bytes.resize(bytes.len().next_multiple_of(stride), 0xaa);
        for value in corner {
            bytes.extend(&value.to_le_bytes()[..size]);
        }
    }
    let mut document = with("/extensionsRequired", json!(["KHR_mesh_quantization"]));
    set(&mut document, "/meshes/0/primitives/0", json!({ "attributes": { "POSITION": 0 } }));
    let view = json!({ "buffer": 0, "byteLength": bytes.len(), "byteStride": stride });
    set(&mut document, "/bufferViews/0", view);
    set(&mut document, "/buffers/0", json!({ "byteLength": bytes.len(), "uri": data_uri(&bytes) }));
    let accessor = json!({
        "bufferView": 0, "componentType": kind, "normalized": normalized, "count": 3, "type": "VEC3",
    });
    set(&mut document, "/accessors/0", accessor);
    document
}

fn data_uri(bytes: &[u8]) -> String {
    format!("data:application/octet-stream;base64,{}", STANDARD_NO_PAD.encode(bytes))
}

#[test]
fn quantized_positions_are_decoded_by_the_specifications_formulae() {
    let corners = |document: &Value| load(document).triangles()[0].vertices;
    let v = DVec3::new;
    let bytes = [-128, -127, 0, 127, 64, 0, -64, 127, 1];
    let one = |c: i32, full: f64| (f64::from(c) / full).max(-1.0);
    assert_eq!(
        corners(&quantized(&bytes, 1, 4, 5120, false)),
        [v(-128.0, -127.0, 0.0), v(127.0, 64.0, 0.0), v(-64.0, 127.0, 1.0)]
    );
    assert_eq!(
        corners(&quantized(&bytes, 1, 4, 5120, true)),
        [v(-1.0, -1.0, 0.0), v(1.0, one(64, 127.0), 0.0), v(one(-64, 127.0), 1.0, one(1, 127.0))]
    );
    let bytes = [0, 255, 0, 51, 0, 0, 255, 102, 255];
    assert_eq!(
        corners(&quantized(&bytes, 1, 4, 5121, true)),
        [v(0.0, 1.0, 0.0), v(0.2, 0.0, 0.0), v(1.0, 0.4, 1.0)]
    );
    let shorts = [-32768, 32767, 0, 16384, 0, 0, -16384, 0, 1];
    assert_eq!(
        corners(&quantized(&shorts, 2, 8, 5122, true)),
        [v(-1.0, 1.0, 0.0), v(one(16384, 32767.0), 0.0, 0.0), v(one(-16384, 32767.0), 0.0, one(1, 32767.0))]
    );
    let shorts = [0, 65535, 0, 13107, 0, 7, 65535, 0, 0];
    assert_eq!(
        corners(&quantized(&shorts, 2, 8, 5123, false)),
        [v(0.0, 65535.0, 0.0), v(13107.0, 0.0, 7.0), v(65535.0, 0.0, 0.0)]
    );
    assert_eq!(
        corners(&quantized(&shorts, 2, 8, 5123, true)),
        [v(0.0, 1.0, 0.0), v(0.2, 0.0, one(7, 65535.0)), v(1.0, 0.0, 0.0)]
    );
    // The node brings them to their true size, as the extension means it to.
    let mut scaled = quantized(&shorts, 2, 8, 5123, true);
    set(&mut scaled, "/nodes/0/scale", json!([5, 5, 5]));
    set(&mut scaled, "/nodes/0/translation", json!([-1, 0, 0]));
    assert_eq!(corners(&scaled)[1], v(0.0, 0.0, 5.0 * one(7, 65535.0)));
    // Without the declaration integers are a mistake, and integers of 32 bits always are.
    let mut undeclared = quantized(&shorts, 2, 8, 5123, true);
    set(&mut undeclared, "/extensionsRequired", json!([]));
    assert_names(refused(&undeclared), &["KHR_mesh_quantization"]);
    assert_names(refused(&quantized(&[0; 9], 4, 12, 5125, false)), &["accessor 0", "positions"]);
}

/// The strip with instances of these attributes, each a list of floats in a buffer of its own.
fn instanced(attributes: &[(&str, &[f32], &str)]) -> Value {
    let mut document = document();
    let mut names = serde_json::Map::new();
    for (name, numbers, shape) in attributes {
        let bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let push = |list: &str, value: Value, document: &mut Value| {
            let list = document[list].as_array_mut().unwrap();
            list.push(value);
            list.len() - 1
        };
        let buffer = json!({ "byteLength": bytes.len(), "uri": data_uri(&bytes) });
        let buffer = push("buffers", buffer, &mut document);
        let view = json!({ "buffer": buffer, "byteLength": bytes.len() });
        let view = push("bufferViews", view, &mut document);
        let lanes = if *shape == "VEC4" { 4 } else { 3 };
        let accessor = json!({
            "bufferView": view, "componentType": 5126, "count": numbers.len() / lanes, "type": shape,
        });
        names.insert((*name).to_owned(), json!(push("accessors", accessor, &mut document)));
    }
    let extension = json!({ "EXT_mesh_gpu_instancing": { "attributes": names } });
    set(&mut document, "/nodes/0/extensions", extension);
    set(&mut document, "/extensionsRequired", json!(["EXT_mesh_gpu_instancing"]));
    document
}

/// The box around each pair of triangles: one copy of the strip.
fn boxes(scene: &Scene) -> Vec<(DVec3, DVec3)> {
    let round = |v: DVec3| (v * 1e6).round() / 1e6;
    let both = |pair: &[super::Triangle]| super::triangle::bounds(pair).unwrap();
    scene.triangles().chunks(2).map(both).map(|(low, high)| (round(low), round(high))).collect()
}

#[test]
fn instances_are_placed_in_their_nodes_frame() {
    let v = DVec3::new;
    let translation = ("TRANSLATION", &[0.0, 0.0, 0.0, 10.0, 0.0, 1.0][..], "VEC3");
    let scene = load(&instanced(&[translation]));
    assert_eq!(boxes(&scene), [(v(0.0, 0.0, 0.0), v(1.0, 1.0, 0.0)), (v(10.0, 0.0, 1.0), v(11.0, 1.0, 1.0))]);
    // A quarter turn about z, twice the size, mirrored in x: scale first, then rotation, then translation.
    let half = 0.5_f32.sqrt();
    let rotation = ("ROTATION", &[0.0, 0.0, half, half, 0.0, 0.0, 0.0, 1.0][..], "VEC4");
    let scale = ("SCALE", &[2.0, 1.0, 1.0, -1.0, 1.0, 1.0][..], "VEC3");
    let ids = ("_ID", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0][..], "VEC3");
    let mut document = instanced(&[scale, ids, translation, rotation]);
    let expected = [(v(-1.0, 0.0, 0.0), v(0.0, 2.0, 0.0)), (v(9.0, 0.0, 1.0), v(10.0, 1.0, 1.0))];
    assert_eq!(boxes(&load(&document)), expected);
    // The mirrored copy still faces +z.
    assert!(load(&document).triangles().iter().all(|t| (t.normal() - DVec3::Z).length() < 1e-6));
    // All of it follows the node, and rules find the copies by the node's name.
    set(&mut document, "/nodes/0/translation", json!([0, 0, 100]));
    let rule = MaterialRule { name: "strip".into(), reflectance: Some(0.5), ..MaterialRule::default() };
    let options = super::LoadOptions { materials: vec![rule], ..raw() };
    let scene = load_with(&document, &options).0.unwrap();
    assert_eq!(scene.bounds().unwrap().0.z, 100.0);
    assert!(scene.materials().len() == 1 && scene.materials()[0].reflectance == 0.5);
    // Attributes that say nothing of the place still say how many there are.
    assert_eq!(load(&instanced(&[ids])).triangles().len(), 4);
}

#[test]
fn instances_with_mistakes_name_their_node() {
    let good = || instanced(&[("TRANSLATION", &[0.0; 6], "VEC3")]);
    let attributes = "/nodes/0/extensions/EXT_mesh_gpu_instancing/attributes";
    let changed = |value: Value| {
        let mut document = good();
        set(&mut document, attributes, value);
        refused(&document)
    };
    for (attributes, words) in [
        (json!({}), &["attributes"][..]),
        (json!(3), &["attributes"]),
        (json!({ "SCALE": -1 }), &["`SCALE`", "accessor"]),
        (json!({ "TRANSLATION": 2, "SCALE": 0 }), &["`SCALE`", "5 values", "2"]),
    ] {
        let message = changed(attributes);
        assert_names(&message, &["node 0", "`strip`", "EXT_mesh_gpu_instancing"]);
        assert_names(&message, words);
    }
    for (attributes, words) in [
        (json!({ "SCALE": 99 }), &["accessor 99"][..]),
        (json!({ "TRANSLATION": 1 }), &["accessor 1", "32-bit floats"]),
        (json!({ "ROTATION": 2 }), &["accessor 2", "rotations"]),
    ] {
        assert_names(changed(attributes), words);
    }
    let infinite = instanced(&[("TRANSLATION", &[0.0, f32::INFINITY, 0.0], "VEC3")]);
    assert_names(refused(&infinite), &["accessor 2", "value 0", "finite"]);
}

#[test]
fn a_small_file_cannot_ask_for_endless_work() {
    // Accessors without a buffer are zeros and may declare much.
    let zeros = |count: u64| json!({ "componentType": 5126, "count": count, "type": "VEC3" });
    let mut many = instanced(&[("TRANSLATION", &[0.0; 9], "VEC3")]);
    set(&mut many, "/accessors/1", zeros(1 << 24));
    set(&mut many, "/meshes/0/primitives/0", json!({ "attributes": { "POSITION": 1 }, "mode": 5 }));
    assert_names(refused(&many), &["50000000 triangles"]);
    set(&mut many, "/accessors/1", zeros(u64::MAX));
    assert_names(refused(&many), &["accessor 1", "18446744073709551615 values", "buffer view"]);
    // Copies of points alone are no work, and copies take bytes in the file.
    set(&mut many, "/meshes/0/primitives/0", json!({ "attributes": { "POSITION": 0 }, "mode": 0 }));
    assert_names(refused(&many), &["triangle"]);
    set(&mut many, "/accessors/2", zeros(1 << 24));
    assert_names(refused(&many), &["`TRANSLATION`", "buffer view"]);
    // Sparse parts whose indices do not ascend are refused, so that they need no table.
    let sparse = json!({
        "count": 2,
        "indices": { "bufferView": 1, "byteOffset": 4, "componentType": 5121 },
        "values": { "bufferView": 0 },
    });
    let unsorted = with("/accessors/0/sparse", sparse);
    assert_names(refused(&unsorted), &["accessor 0", "sparse", "value 2", "3"]);
}
