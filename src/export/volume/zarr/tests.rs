#![allow(clippy::unwrap_used)]
use super::*;
use crate::export::read_volume;
use crate::grid::Volume;
use std::collections::BTreeMap;
use std::fs;

/// A volume of several shards and levels, with no two voxels alike.
fn volume() -> Volume {
    let axis = |first, count| Axis { first, pitch: 0.01, count };
    let grid = Grid { x: axis(-0.3, 131), y: axis(0.1, 5), z: axis(1.0, 67) };
    let value = |i: usize| Complex32::from_polar(((i * 7919) % 104_729) as f32, i as f32);
    Volume::new(grid, (0..131 * 5 * 67).map(value).collect())
}

fn written(path: &Path, volume: &Volume, components: Components, compression: Compression) {
    let meta = json!({ "sound_speed": 343.25, "note": "ü" });
    write_volume_zarr(path, volume, components, &meta, compression).unwrap();
}

/// All files of a store.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                all.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    all
}

#[test]
fn a_volume_is_read_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("volume.zarr");
    let volume = volume();
    for compression in [Compression::Zip, Compression::None] {
        written(&path, &volume, Components::Complex, compression);
        let (found, meta) = read_volume(&path, 1 << 24).unwrap();
        assert!(found == volume && meta == json!({ "sound_speed": 343.25, "note": "ü" }));
        assert!(Amplitude::read(&path, 1 << 24).unwrap() == Amplitude::of(&volume).unwrap());
    }
    written(&path, &volume, Components::Amplitude, Compression::Zip);
    assert!(Amplitude::read(&path, 1 << 24).unwrap() == Amplitude::of(&volume).unwrap());
    let error = read_volume(&path, 1 << 24).unwrap_err().to_string();
    assert!(error.contains("output.components=complex"), "{error}");
    let error = Amplitude::read(&path, 1000).unwrap_err();
    assert_eq!(error.exit_status(), 2, "{error}");
}

#[test]
fn bytes_depend_neither_on_threads_nor_on_how_planes_come() {
    let folder = tempfile::tempdir().unwrap();
    let volume = volume();
    let write = |name: &str, threads: usize, planes: usize| {
        let path = folder.path().join(name);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let meta = json!({});
            let mut file =
                stream_volume_zarr(&path, &volume.grid, Components::Complex, &meta, Compression::Zip, None)
                    .unwrap();
            volume.samples.chunks(planes * volume.grid.plane_len()).for_each(|p| file.take(p).unwrap());
            file.finish().unwrap();
        });
        files(&path)
    };
    let all = write("a.zarr", 1, 67);
    assert_eq!(all.keys().filter(|name| name.starts_with("samples/c/")).count(), 3, "{:?}", all.keys());
    assert!(all == write("b.zarr", 4, 1));
    assert!(all == write("c.zarr", 2, 10));
}

/// Shards by number.
struct ShardsByNumber(Vec<Option<Vec<u8>>>);

impl EncodedShards for ShardsByNumber {
    fn shard(&self, number: u64) -> Option<Vec<u8>> {
        self.0[number as usize].clone()
    }
}

#[test]
fn shards_that_others_have_encoded_are_those_of_the_store() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("volume.zarr");
    let volume = volume();
    let plane = |depth: usize| volume.samples.chunks(volume.grid.plane_len()).nth(depth).map(<[_]>::to_vec);
    for (components, compression) in [
        (Components::Complex, Compression::Zip),
        (Components::Complex, Compression::None),
        (Components::Amplitude, Compression::Zip),
    ] {
        let write = |known: Option<&ShardsByNumber>| {
            let known = known.map(|known| known as &dyn EncodedShards);
            let mut file =
                stream_volume_zarr(&path, &volume.grid, components, &json!({}), compression, known).unwrap();
            file.take(&volume.samples).unwrap();
            file.finish().unwrap();
            files(&path)
        };
        let whole = write(None);
        let shards = VolumeShards::new(&volume.grid, components, compression);
        let encoded = |number| shards.encode(number, |depth| Ok(plane(depth))).unwrap();
        let mut known = ShardsByNumber((0..shards.count()).map(encoded).collect());
        assert!(write(Some(&known)) == whole, "{components:?} {compression:?}");
        assert!(known.0.iter().flatten().all(|shard| shard.len() as u64 <= shards.most_bytes()));
        // Some are lost; and those that are there are taken.
        known.0[1] = None;
        assert!(write(Some(&known)) == whole, "{components:?} {compression:?}");
        known.0[2] = Some(b"made elsewhere".to_vec());
        let differing = write(Some(&known)).into_iter().filter(|(name, bytes)| whole[name] != *bytes);
        assert_eq!(differing.map(|(_, bytes)| bytes).collect::<Vec<_>>(), [b"made elsewhere"]);
        // They end in order, and each needs all of its depths.
        let all: Vec<u64> = (0..shards.count()).collect();
        assert!(all.windows(2).all(|pair| shards.depths(&pair[..1]).end <= shards.depths(&pair[1..]).end));
        assert_eq!(shards.depths(&all), 0..volume.grid.z.count);
        let without_one = |depth| Ok(plane(depth).filter(|_| depth != 40));
        for &number in &all {
            let found = shards.encode(number, without_one).unwrap();
            assert_eq!(found.is_none(), shards.depths(&[number]).contains(&40));
        }
    }
}

#[test]
fn each_level_holds_the_maxima_of_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("volume.zarr");
    let volume = volume();
    written(&path, &volume, Components::Amplitude, Compression::None);
    let mut before = Amplitude::of(&volume).unwrap();
    let expected = levels(&volume.grid);
    assert_eq!(
        expected.iter().map(Grid::shape).collect::<Vec<_>>(),
        [[67, 5, 131], [34, 3, 66], [17, 2, 33]]
    );
    for (k, grid) in expected.iter().enumerate().skip(1) {
        // A level is a group that is opened by itself.
        let level = Amplitude::read(&rename(&path, k), 1 << 24).unwrap();
        let close = |a: &Axis, b: &Axis| a.count == b.count && (a.first - b.first).abs() < 1e-12;
        assert!(close(&level.grid.x, &grid.x) && close(&level.grid.z, &grid.z));
        // The literal definition.
        let shape = before.grid.shape();
        let mut maxima = vec![0.0_f32; grid.voxel_count() as usize];
        for (i, value) in before.values.iter().enumerate() {
            let [z, y, x] = [i / (shape[1] * shape[2]), i / shape[2] % shape[1], i % shape[2]];
            let at = (z / 2 * grid.y.count + y / 2) * grid.x.count + x / 2;
            maxima[at] = maxima[at].max(*value);
        }
        assert!(level.values == maxima, "level {k}");
        before = level;
    }
}

/// A level under a name by which it is recognised.
fn rename(store: &Path, level: usize) -> std::path::PathBuf {
    let path = store.with_file_name(format!("level{level}.zarr"));
    fs::rename(store.join(format!("levels/{level}")), &path).unwrap();
    path
}

#[test]
fn an_axis_of_one_voxel_is_never_halved() {
    let axis = |count| Axis { first: 0.0, pitch: 0.5, count };
    let grid = Grid { x: axis(200), y: axis(1), z: axis(2) };
    let all = levels(&grid);
    assert_eq!(all.iter().map(Grid::shape).collect::<Vec<_>>(), [[2, 1, 200], [1, 1, 100], [1, 1, 50]]);
    assert_eq!(all[2].y, axis(1));
    assert_eq!((all[2].z.first, all[2].x.first, all[2].x.pitch), (0.25, 0.75, 2.0));
    let ome = ome(&all);
    assert_eq!(ome["multiscales"][0]["datasets"][2]["path"], "levels/2/amplitude");
    assert_eq!(
        ome["multiscales"][0]["datasets"][1]["coordinateTransformations"][0]["scale"],
        json!([1.0, 0.5, 1.0])
    );
}
