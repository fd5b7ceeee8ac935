//! From mesh file to rays: reading, building the tree, and rays per second, which determine the time that sampling
//! reflectors takes.

#![allow(missing_docs)]

mod job;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use holosonar::reflectors::{SurfaceOptions, sample_surface};
use holosonar::scene::{LoadOptions, Material, Scene, Triangle, Unit, Up};
use job::scattered;
use rayon::prelude::*;
use std::hint::black_box;
use std::io::Write;
use std::path::Path;

/// The corners of a wavy sheet of 2·n² triangles, 2 m wide at depth 2 m, and the three corners of each triangle.
fn sheet(n: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let corner = |k: usize| {
        let (i, j) = (k % (n + 1), k / (n + 1));
        let (x, y) = (2.0 * i as f64 / n as f64 - 1.0, 2.0 * j as f64 / n as f64 - 1.0);
        DVec3::new(x, y, 2.0 + 0.1 * (9.0 * x).sin() * (7.0 * y).cos())
    };
    let corners = (0..(n + 1) * (n + 1)).map(corner).collect();
    let at = |i: usize, j: usize| (j * (n + 1) + i) as u32;
    let faces = (0..n * n)
        .flat_map(|k| {
            let (i, j) = (k % n, k / n);
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    (corners, faces)
}

fn triangles((corners, faces): &(Vec<DVec3>, Vec<[u32; 3]>)) -> Vec<Triangle> {
    let vertices = |face: &[u32; 3]| face.map(|k| corners[k as usize]);
    faces.iter().map(|face| Triangle { vertices: vertices(face), material: 0 }).collect()
}

fn scene(triangles: Vec<Triangle>, transmittance: f64) -> Scene {
    let material =
        Material { name: String::new(), reflectance: 1.0, transmittance, source: "bench".to_owned() };
    Scene::new(triangles, vec![material]).expect("finite triangles")
}

/// Writes the sheet in every format, as `sheet.obj` and so on.
fn write_files(folder: &Path, (corners, faces): &(Vec<DVec3>, Vec<[u32; 3]>)) -> std::io::Result<()> {
    let mut obj = Vec::new();
    for v in corners {
        writeln!(obj, "v {:.6} {:.6} {:.6}", v.x, v.y, v.z)?;
    }
    for [a, b, c] in faces {
        writeln!(obj, "f {} {} {}", a + 1, b + 1, c + 1)?;
    }
    std::fs::write(folder.join("sheet.obj"), obj)?;

    let number = |v: f64| (v as f32).to_le_bytes();
    let positions: Vec<u8> = corners.iter().flat_map(DVec3::to_array).flat_map(number).collect();
    let indices: Vec<u8> = faces.iter().flatten().flat_map(|k| k.to_le_bytes()).collect();
    let (n_positions, n_indices) = (positions.len(), indices.len());
    let mut json = serde_json::json!({
        "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": corners.len(), "type": "VEC3" },
            { "bufferView": 1, "componentType": 5125, "count": 3 * faces.len(), "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": n_positions },
            { "buffer": 0, "byteOffset": n_positions, "byteLength": n_indices },
        ],
        "buffers": [{ "byteLength": n_positions + n_indices }],
    })
    .to_string();
    while !json.len().is_multiple_of(4) {
        json.push(' ');
    }
    let mut glb = b"glTF".to_vec();
    for word in [2, 28 + json.len() + n_positions + n_indices, json.len()] {
        glb.extend((word as u32).to_le_bytes());
    }
    glb.extend(b"JSON");
    glb.extend(json.as_bytes());
    glb.extend(((n_positions + n_indices) as u32).to_le_bytes());
    glb.extend(b"BIN\0");
    glb.extend([&positions[..], &indices].concat());
    std::fs::write(folder.join("sheet.glb"), glb)?;

    let mut stl = vec![b' '; 80];
    stl.extend((faces.len() as u32).to_le_bytes());
    for face in faces {
        stl.extend([0; 12]);
        stl.extend(face.iter().flat_map(|&k| corners[k as usize].to_array()).flat_map(number));
        stl.extend([0; 2]);
    }
    std::fs::write(folder.join("sheet.stl"), stl)?;

    let mut ply = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        corners.len(),
        faces.len()
    )
    .into_bytes();
    ply.extend(&positions);
    for face in faces {
        ply.push(3);
        ply.extend(face.iter().flat_map(|k| k.to_le_bytes()));
    }
    std::fs::write(folder.join("sheet.ply"), ply)
}

/// A million triangles: loading each file format, building the tree alone, and the shadow rays of 100 000 reflectors.
fn a_million_triangles(c: &mut Criterion) {
    let sheet = sheet(708);
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_files(folder.path(), &sheet).expect("room for the files");
    let mut group = c.benchmark_group("scene of 1M triangles");
    group.throughput(Throughput::Elements(sheet.1.len() as u64)).sample_size(10);
    let mut options = LoadOptions::default();
    options.up = Some(Up::None);
    for kind in ["obj", "glb", "stl", "ply"] {
        options.unit = (kind != "glb").then_some(Unit::Metre);
        let path = folder.path().join("sheet").with_extension(kind);
        group.bench_function(BenchmarkId::new("load", kind), |b| {
            b.iter(|| Scene::load(&path, &options).expect("a scene").triangles().len());
        });
    }
    let soup = triangles(&sheet);
    group.bench_function("build", |b| {
        b.iter_batched(
            || soup.clone(),
            |soup| black_box(scene(soup, 0.0)).triangles().len(),
            criterion::BatchSize::PerIteration,
        );
    });
    let scene = scene(soup, 0.0);
    // A dense random cover has 0.62 points per square of the spacing.
    let options = SurfaceOptions::new((0.62 * scene.surface_area() / 1e5).sqrt(), 0.023);
    let sampled = || sample_surface(&scene, &options).expect("reflectors");
    let reflectors = sampled();
    group.throughput(Throughput::Elements(reflectors.len() as u64));
    group.bench_function(BenchmarkId::new("shadow rays", reflectors.len()), |b| {
        b.iter(|| {
            let rays = reflectors.positions().par_iter();
            rays.map(|&p| scene.transmittance(DVec3::ZERO, p)).sum::<f64>()
        });
    });
    group.bench_function(BenchmarkId::new("sample and occlude", reflectors.len()), |b| b.iter(sampled));
    group.finish();
}

fn rays(c: &mut Criterion) {
    const RAYS: usize = 20_000;
    let mut group = c.benchmark_group("occlusion");
    group.throughput(Throughput::Elements(RAYS as u64)).sample_size(10);
    for (n, name) in [(224, "100k triangles"), (708, "1M triangles")] {
        let scene = scene(triangles(&sheet(n)), 0.5);
        let target = |i: usize, z: f64| (2.0 * scattered(i)).with_z(z);
        // An unobstructed path, as for most reflectors; and one through the sheet, as in a transparent scene.
        for (kind, z) in [("short of the surface", 1.85), ("through to 3 m", 3.0)] {
            group.bench_with_input(BenchmarkId::new(kind, name), &z, |b, &z| {
                b.iter(|| {
                    (0..RAYS)
                        .into_par_iter()
                        .map(|i| scene.transmittance(DVec3::ZERO, target(i, z)))
                        .sum::<f64>()
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, rays, a_million_triangles);
criterion_main!(benches);
