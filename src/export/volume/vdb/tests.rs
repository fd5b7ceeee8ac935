use super::*;
use crate::grid::{Axis, Volume};
use flate2::read::ZlibDecoder;
use num_complex::Complex32;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::BTreeMap;
use std::io::Read;

/// A file, taken apart literally.
#[derive(Debug, PartialEq)]
struct Decoded {
    uuid: String,
    /// Type and bytes by name.
    metadata: BTreeMap<String, (String, Vec<u8>)>,
    /// Translation, scale, size of a voxel, 1/scale, 1/scale², 1/2 scale.
    map: [[f64; 3]; 6],
    nodes: [usize; 3],
    active: BTreeMap<[i32; 3], f32>,
}

struct Bytes<'a>(&'a [u8], usize);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> &'a [u8] {
        self.1 += count;
        &self.0[self.1 - count..self.1]
    }

    fn number<const N: usize>(&mut self) -> [u8; N] {
        self.take(N).try_into().unwrap()
    }

    fn u32(&mut self) -> usize {
        u32::from_le_bytes(self.number()) as usize
    }

    fn i64(&mut self) -> i64 {
        i64::from_le_bytes(self.number())
    }

    fn text(&mut self) -> String {
        let length = self.u32();
        String::from_utf8(self.take(length).to_vec()).unwrap()
    }

    /// The numbers of the bits of a mask that are set.
    fn mask(&mut self, bits: usize) -> Vec<i32> {
        let bytes = self.take(bits / 8);
        (0..bits).filter(|bit| bytes[bit / 8] >> (bit % 8) & 1 == 1).map(|bit| bit as i32).collect()
    }

    /// The values of so many active voxels.
    fn values(&mut self, count: usize, zip: bool) -> Vec<f32> {
        assert_eq!(self.take(1), [0], "inactive values are the background");
        let mut bytes = Vec::new();
        let length = if zip { self.i64() } else { -4 * count as i64 };
        if length > 0 {
            ZlibDecoder::new(self.take(length as usize)).read_to_end(&mut bytes).unwrap();
        } else {
            bytes = self.take(-length as usize).to_vec();
        }
        assert_eq!(bytes.len(), 4 * count);
        bytes.chunks_exact(4).map(|float| f32::from_le_bytes(float.try_into().unwrap())).collect()
    }

    /// Masks and values of an inner node; where its children begin.
    fn children(&mut self, origin: [i32; 3], log: u32, side: i32, zip: bool) -> Vec<[i32; 3]> {
        let children = self.mask(1 << (3 * log));
        assert_eq!(self.mask(1 << (3 * log)), [0; 0], "no tile is active");
        self.values(0, zip);
        let low = (1 << log) - 1;
        let place = |n: i32| [n >> (2 * log), n >> log & low, n & low];
        let begin = |n| std::array::from_fn(|axis| origin[axis] + side * place(n)[axis]);
        children.into_iter().map(begin).collect()
    }
}

fn decode(path: &Path) -> Decoded {
    let bytes = std::fs::read(path).unwrap();
    let mut file = Bytes(&bytes, 0);
    assert_eq!(file.i64(), 0x5644_4220);
    assert_eq!((file.u32(), file.u32(), file.u32(), file.take(1)), (224, 10, 0, &[1_u8][..]));
    let uuid = String::from_utf8(file.take(36).to_vec()).unwrap();
    assert_eq!((file.u32(), file.u32()), (0, 1), "no metadata, one grid");
    assert_eq!([file.text(), file.text(), file.text()], ["density", "Tree_float_5_4_3", ""]);
    let [grid, blocks, end] = [file.i64(), file.i64(), file.i64()].map(|place| place as usize);
    assert_eq!((grid, end), (file.1, bytes.len()));
    let flags = file.u32();
    assert!([2, 3].contains(&flags));
    let zip = flags == 3;
    let entries = file.u32();
    let metadata: BTreeMap<_, _> = (0..entries)
        .map(|_| {
            (
                file.text(),
                (file.text(), {
                    let length = file.u32();
                    file.take(length).to_vec()
                }),
            )
        })
        .collect();
    assert_eq!(metadata.len(), entries);
    assert_eq!(file.text(), "ScaleTranslateMap");
    let map = std::array::from_fn(|_| std::array::from_fn(|_| f64::from_le_bytes(file.number())));
    assert_eq!((file.u32(), file.u32(), file.u32()), (1, 0, 0), "one buffer, background 0, no tiles");
    let roots = file.u32();
    let (mut lowers, mut leaves) = (0, Vec::new());
    for _ in 0..roots {
        let origin = std::array::from_fn(|_| i32::from_le_bytes(file.number()));
        for lower in file.children(origin, 5, 128, zip) {
            lowers += 1;
            let children = file.children(lower, 4, 8, zip);
            leaves.extend(children.into_iter().map(|leaf| (leaf, file.mask(512))));
        }
    }
    assert_eq!(blocks, file.1);
    let nodes = [roots, lowers, leaves.len()];
    let mut active = BTreeMap::new();
    for ([x, y, z], mask) in leaves {
        assert_eq!(file.mask(512), mask);
        let values = file.values(mask.len(), zip);
        active.extend(mask.into_iter().map(|n| [x + n / 64, y + n / 8 % 8, z + n % 8]).zip(values));
    }
    assert_eq!(file.1, bytes.len());
    Decoded { uuid, metadata, map, nodes, active }
}

fn volume(count: [usize; 3], samples: impl FnMut(usize) -> Complex32) -> Volume {
    let [x, y, z] = count;
    let grid = Grid {
        x: Axis { first: -0.5, pitch: 0.1 / 3.0, count: x },
        y: Axis { first: 0.7, pitch: 0.2, count: y },
        z: Axis { first: 1.3, pitch: 0.007, count: z },
    };
    Volume::new(grid, (0..x * y * z).map(samples).collect())
}

/// Amplitudes of 60 dB, with some numbers that are not finite.
fn noise(count: [usize; 3], seed: u64) -> Volume {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    volume(count, |i| {
        let mut uniform = || random.next_u32() as f32 / u32::MAX as f32;
        let sample = Complex32::from_polar(5.0 * 10_f32.powf(-3.0 * uniform()), 6.3 * uniform());
        match i % 97 {
            13 => Complex32::new(f32::NAN, 1.0),
            14 => Complex32::new(0.0, f32::INFINITY),
            _ => sample,
        }
    })
}

/// What a file must contain, voxel by voxel.
fn expected(volume: &Volume, threshold: f32) -> BTreeMap<[i32; 3], f32> {
    let grid = &volume.grid;
    let finite = volume.samples.iter().map(|sample| sample.norm()).filter(|norm| norm.is_finite());
    let peak = finite.fold(0.0, f32::max);
    let mut active = BTreeMap::new();
    for iz in 0..grid.z.count {
        for (i, sample) in volume.plane(iz).iter().enumerate() {
            let (iy, ix) = (i / grid.x.count, i % grid.x.count);
            let density = sample.norm() / peak;
            if density.is_finite() && density >= threshold {
                active.insert([ix, iz, grid.y.count - 1 - iy].map(|i| i as i32), density);
            }
        }
    }
    active
}

#[test]
fn every_voxel_is_where_a_literal_decoder_expects_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vdb");
    for (count, nodes) in [
        ([1, 1, 1], [1, 1, 1]),
        ([8, 8, 8], [1, 1, 1]),
        ([9, 17, 5], [1, 1, 6]),
        ([130, 5, 257], [1, 6, 561]),
        ([2, 3, 4100], [2, 33, 513]),
        ([4097, 1, 3], [2, 33, 513]),
    ] {
        let volume = noise(count, 1);
        for compression in [Compression::Zip, Compression::None] {
            write_volume_vdb(&path, &volume, -40.0, &[], compression).unwrap();
            let decoded = decode(&path);
            assert!(decoded.active == expected(&volume, 0.01), "{count:?}, {compression}");
            assert!(decoded.active.values().any(|&density| density == 1.0), "{count:?}");
            assert_eq!(decoded.nodes, nodes, "{count:?}");
        }
        write_volume_vdb(&path, &volume, f64::NEG_INFINITY, &[], Compression::Zip).unwrap();
        assert!(decode(&path).active == expected(&volume, 0.0), "{count:?}, no threshold");
    }
}

#[test]
fn what_is_alike_takes_little_space_and_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let [zip, plain] = ["zip.vdb", "plain.vdb"].map(|name| folder.path().join(name));
    let volume = volume([20, 20, 20], |_| Complex32::new(0.0, -3.0));
    write_volume_vdb(&zip, &volume, -40.0, &[], Compression::Zip).unwrap();
    write_volume_vdb(&plain, &volume, -40.0, &[], Compression::None).unwrap();
    assert_eq!(decode(&zip).active, decode(&plain).active);
    assert_eq!(decode(&zip).active.len(), 8000);
    let length = |path: &Path| std::fs::metadata(path).unwrap().len();
    assert!(length(&plain) > length(&zip) + 30_000, "{} {}", length(&plain), length(&zip));
}

#[test]
fn a_volume_of_zeros_is_an_empty_grid() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vdb");
    write_volume_vdb(&path, &volume([9, 9, 9], |_| Complex32::ZERO), -40.0, &[], Compression::Zip).unwrap();
    let decoded = decode(&path);
    assert_eq!((decoded.nodes, decoded.active.len()), ([0; 3], 0));
    assert_eq!(decoded.metadata["sonar:amplitudeScale"], ("double".into(), vec![0; 8]));
}

#[test]
fn metadata_and_transform_are_those_of_the_volume() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vdb");
    let volume = noise([4, 6, 5], 2);
    let attributes = [
        ("sonar:run".to_owned(), Attribute::Text("{\"é\": 1}".into())),
        ("sonar:soundSpeed".to_owned(), Attribute::Number(343.25)),
        ("sonar:seed".to_owned(), Attribute::Integer(-3)),
        ("sonar:source".to_owned(), Attribute::Vector([0.5, -1.0, 2.0])),
    ];
    write_volume_vdb(&path, &volume, -20.0, &attributes, Compression::None).unwrap();
    let decoded = decode(&path);
    let of = |name: &str| {
        let (kind, value) = &decoded.metadata[name];
        (kind.as_str(), value.clone())
    };
    assert_eq!(decoded.metadata.len(), 11);
    assert_eq!(of("class"), ("string", b"fog volume".to_vec()));
    assert_eq!(of("name"), ("string", b"density".to_vec()));
    assert_eq!(of("sonar:run"), ("string", "{\"é\": 1}".into()));
    assert_eq!(of("sonar:soundSpeed"), ("double", 343.25_f64.to_le_bytes().to_vec()));
    assert_eq!(of("sonar:seed"), ("int64", (-3_i64).to_le_bytes().to_vec()));
    assert_eq!(of("sonar:source"), ("vec3d", [0.5_f64, -1.0, 2.0].map(f64::to_le_bytes).concat()));
    assert_eq!(of("sonar:thresholdDb"), ("double", (-20.0_f64).to_le_bytes().to_vec()));
    assert_eq!(of("sonar:gridShape"), ("vec3d", [4.0_f64, 6.0, 5.0].map(f64::to_le_bytes).concat()));
    let (_, scale) = of("sonar:amplitudeScale");
    let peak = f64::from_le_bytes(scale.try_into().unwrap()) as f32;
    assert!(decoded.active == expected(&volume, 0.1) && volume.samples.iter().any(|s| s.norm() == peak));
    // Where each voxel is in Blender's world.
    let [translation, scale, size, inverse, squares, halves] = decoded.map;
    for (ix, iy, iz) in [(0, 0, 0), (3, 5, 4), (1, 2, 3)] {
        let p = volume.grid.position(ix, iy, iz);
        let index = [ix, iz, 5 - iy];
        for (axis, expected) in [p.x, p.z, -p.y].into_iter().enumerate() {
            let world = translation[axis] + scale[axis] * index[axis] as f64;
            assert!((world - expected).abs() < 1e-14, "{world} {expected}");
        }
    }
    assert_eq!(size, scale);
    for axis in 0..3 {
        assert_eq!(inverse[axis], 1.0 / scale[axis]);
        assert_eq!((squares[axis], halves[axis]), (inverse[axis] * inverse[axis], inverse[axis] / 2.0));
    }
}

#[test]
fn the_same_volume_gives_the_same_bytes_and_another_another_uuid() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b, c] = ["a.vdb", "b.vdb", "c.vdb"].map(|name| folder.path().join(name));
    let mut volume = noise([20, 10, 30], 3);
    write_volume_vdb(&a, &volume, -40.0, &[], Compression::Zip).unwrap();
    write_volume_vdb(&b, &volume, -40.0, &[], Compression::Zip).unwrap();
    assert!(std::fs::read(&a).unwrap() == std::fs::read(&b).unwrap());
    volume.samples[0] = Complex32::new(0.5, 0.5);
    write_volume_vdb(&c, &volume, -40.0, &[], Compression::Zip).unwrap();
    let [a, c] = [a, c].map(|path| decode(&path).uuid);
    assert_ne!(a, c);
    let parts: Vec<_> = a.split('-').map(str::len).collect();
    assert_eq!(parts, [8, 4, 4, 4, 12]);
    assert_eq!((&a[14..15], &a[19..20]), ("8", "8"));
}
