//! A plane boundary between two media: simulation, images and their adjoint against literal sums over the quickest paths.

use crate::agreement::random_case;
use crate::binary::{done, done_json, refused, run};
use crate::named::assert_names;
use crate::support::{Random, assert_within_bounds, direct, literal, peak, position_of, relative_difference};
use glam::DVec3;
use holosonar::acquisition::{
    DataCube, Instrument, MicArray, PropagationModel, SimulateOptions, Sweep, simulate,
};
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::reflectors::Reflectors;
use holosonar::wave::{Geometry, Interface};
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;
use std::fs;

/// The least length over all crossings of the interface, by golden sections: Fermat's principle as it stands.
fn quickest(interface: &Interface, c: f64, from: DVec3, to: DVec3) -> f64 {
    if to.z <= interface.depth {
        return from.distance(to);
    }
    let aside = from.truncate().distance(to.truncate());
    let length = |x: f64| {
        (interface.depth - from.z).hypot(x)
            + (to.z - interface.depth).hypot(aside - x) * c / interface.sound_speed
    };
    let (mut low, mut high) = (0.0, aside);
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    for _ in 0..100 {
        let (a, b) = (high - golden * (high - low), low + golden * (high - low));
        if length(a) < length(b) {
            high = b;
        } else {
            low = a;
        }
    }
    length(0.5 * (low + high))
}

/// A path of an instrument with an interface.
fn path(instrument: &Instrument, geometry: &Geometry, p: DVec3, r: DVec3) -> f64 {
    let interface = instrument.interface.unwrap();
    let leg = |from: DVec3| quickest(&interface, instrument.sound_speed, from, p);
    match geometry {
        Geometry::FixedSource { source } => leg(*source) + leg(r),
        Geometry::Monostatic => 2.0 * leg(r),
        Geometry::Pair { offset } => leg(r + *offset) + leg(r),
    }
}

/// A random measurement and grid, with an interface before, within or behind the grid, to a faster or slower medium.
fn layered_case(seed: u64) -> (DataCube, Grid, Window) {
    let (mut cube, mut grid, window) = random_case(seed);
    let nearest = cube.instrument.array.bounds().1.z;
    let nearest = match cube.instrument.geometry {
        Geometry::FixedSource { source } => nearest.max(source.z),
        Geometry::Monostatic => nearest,
        Geometry::Pair { offset } => nearest.max(nearest + offset.z),
    };
    grid.z.first = grid.z.first.max(nearest + 0.08);
    let middle = grid.z.first + [-0.05, 0.4, 0.9][seed as usize % 3] * (grid.z.last() - grid.z.first);
    let sound_speed = [150.0, 900.0, 2500.0, 343.0][seed as usize / 2 % 4];
    cube.instrument.interface = Some(Interface { depth: middle.max(nearest + 0.02), sound_speed });
    (cube, grid, window)
}

#[test]
fn every_path_is_within_the_bounds_of_its_depth_and_of_all() {
    for seed in 0..40 {
        let (cube, grid, _) = layered_case(seed);
        let instrument = &cube.instrument;
        for iz in 0..grid.z.count {
            let z = Axis { first: grid.z.position(iz), count: 1, ..grid.z };
            let plane = Grid { z, ..grid };
            let ([least, most], [shortest, longest]) =
                (instrument.path_bounds(&plane), instrument.path_bounds(&grid));
            let within = shortest <= least + 1e-12 && most <= longest + 1e-12;
            assert!(
                within,
                "seed {seed}, {grid:?}, depth {iz}, {:?}: {least} .. {most} outside of {shortest} .. {longest}",
                instrument.interface
            );
            for p in (0..plane.plane_len()).map(|v| position_of(&plane, v)) {
                for r in instrument.array.positions() {
                    let length = instrument.path_length(p, *r);
                    let inside = (least - 1e-12..=most + 1e-12).contains(&length);
                    assert!(inside, "seed {seed}, depth {iz}: {length} outside {least} .. {most}");
                }
            }
        }
    }
}

#[test]
fn direct_is_the_literal_sum_over_quickest_paths() {
    for seed in 0..8 {
        let (cube, grid, window) = layered_case(seed);
        let got = direct(&cube, &grid, window);
        let voxels: Vec<usize> = (0..got.len()).step_by(11).collect();
        let of = |geometry: &Geometry, p, r| path(&cube.instrument, geometry, p, r);
        let expected = literal(&cube, &grid, window, of, voxels.iter().copied());
        let got_there: Vec<Complex32> = voxels.iter().map(|v| got[*v]).collect();
        let error = relative_difference(&got_there, &expected) * peak(&expected) / peak(&got);
        assert!(error < 2e-6, "seed {seed}: {error:e}");
    }
}

#[test]
fn convolution_is_direct_beyond_an_interface() {
    for seed in 0..40 {
        let (cube, grid, window) = layered_case(seed);
        let options = ReconstructOptions::new(Method::Convolution, window);
        let exact = reconstruct(&cube, &grid, &options.with_tolerance(0.0)).unwrap().volume.samples;
        let error = relative_difference(&exact, &direct(&cube, &grid, window));
        assert!(error < 1e-5, "seed {seed} {:?}: {error:e}", grid.shape());
        assert_within_bounds(seed, &cube, &grid, &options, &[1e-2, 1e-4, 1e-6]);
    }
}

#[test]
fn scattered_microphones_keep_their_bound_beyond_an_interface() {
    let mut random = Random::new(3);
    for seed in 0..16 {
        let (cube, mut grid, window) = layered_case(seed);
        let z = cube.instrument.array.centre().z;
        let mut place = || DVec3::new(random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), z);
        let positions = (0..cube.instrument.array.len()).map(|_| place()).collect();
        let instrument = cube.instrument.clone().with_array(MicArray::from_positions(positions).unwrap());
        let cube = DataCube::new(instrument, cube.samples).unwrap();
        (grid.x.pitch, grid.y.pitch) = (0.017, 0.0133);
        let options = ReconstructOptions::new(Method::Convolution, window);
        assert_within_bounds(seed, &cube, &grid, &options, &[1e-2, 1e-4]);
    }
}

#[test]
fn simulation_is_the_literal_sum_over_quickest_paths_and_the_adjoint_of_the_image() {
    for seed in 0..12 {
        let (cube, grid, _) = layered_case(seed);
        let mut random = Random::new(seed + 1000);
        let positions: Vec<DVec3> = (0..grid.voxel_count() as usize).map(|v| position_of(&grid, v)).collect();
        let a: Vec<Complex32> = positions.iter().map(|_| random.complex()).collect();
        let reflectors = Reflectors::new(positions.clone(), a.clone()).unwrap();
        let instrument = &cube.instrument;
        let ka = simulate(&reflectors, instrument, &SimulateOptions::default()).unwrap();
        let (n_mic, scale) = (instrument.array.len(), a.iter().map(|a| f64::from(a.norm())).sum::<f64>());
        for (i, m) in ka.samples.iter().enumerate().step_by(7) {
            let (f, r) = (instrument.sweep.frequencies()[i / n_mic], instrument.array.positions()[i % n_mic]);
            let term = |(p, a): (&DVec3, &Complex32)| {
                let turns = f * path(instrument, &instrument.geometry, *p, r) / instrument.sound_speed;
                Complex64::new(a.re.into(), a.im.into()) * Complex64::cis(TAU * turns)
            };
            let exact: Complex64 = positions.iter().zip(&a).map(term).sum();
            let difference = (f64::from(m.re) - exact.re).abs();
            assert!(difference < 1e-5 * scale, "seed {seed}, sample {i}: {m} is not {exact}");
        }
        let dot = |x: &[Complex32], y: &[Complex32]| -> f64 {
            x.iter().zip(y).map(|(x, y)| f64::from((x * y.conj()).re)).sum()
        };
        for method in [Method::Direct, Method::Convolution] {
            let options = ReconstructOptions::new(method, Window::None);
            let volume = reconstruct(&cube, &grid, &options).unwrap().volume;
            let scale = (instrument.sweep.len() * n_mic) as f64 / instrument.detection.weight();
            let (left, right) = (dot(&ka.samples, &cube.samples), dot(&a, &volume.samples) * scale);
            let norms = dot(&ka.samples, &ka.samples).sqrt() * dot(&cube.samples, &cube.samples).sqrt();
            assert!((left - right).abs() < 1e-5 * norms, "seed {seed} {method:?}: {left} against {right}");
        }
    }
}

/// Enough of everything for virtual tones, with more threads than one.
#[test]
fn many_reflectors_are_simulated_at_virtual_tones() {
    let mut random = Random::new(5);
    let mut place =
        || DVec3::new(random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), random.uniform(0.03, 0.2));
    let positions: Vec<DVec3> = (0..300).map(|_| place()).collect();
    let reflectors = Reflectors::new(positions, vec![Complex32::ONE; 300]).unwrap();
    let array = MicArray::rectangular([12, 9], [0.01; 2], DVec3::ZERO).unwrap();
    let sweep = Sweep::stepped(100e3, 200e3, 500.0).unwrap();
    let steel = Interface { depth: 0.05, sound_speed: 5900.0 };
    let instrument = Instrument::new(sweep, array).with_sound_speed(1480.0).with_interface(Some(steel));
    let options = SimulateOptions::default();
    let run = |threads, tolerance| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = options.clone().with_tolerance(tolerance);
        pool.install(|| simulate(&reflectors, &instrument, &options).unwrap().samples)
    };
    let fast = run(1, 1e-6);
    assert_eq!(fast, run(3, 1e-6));
    let error = relative_difference(&fast, &run(2, 0.0));
    assert!(error < 1e-5 && error > 0.0, "{error:e}");
    let linear = options.with_model(PropagationModel::Linear);
    assert_names(
        simulate(&reflectors, &instrument, &linear).unwrap_err().to_string(),
        &["interface", "exact"],
    );
}

/// A flaw in steel under water, where it is only with the interface.
#[test]
fn a_flaw_in_steel_is_found_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("flaw.csv"), "x,y,z,amplitude\n0.006,-0.004,0.05,1\n").unwrap();
    let steel = "{depth=0.02,sound_speed=5900.0}";
    let instrument = "--set medium.sound_speed=1480 --set sweep.start=1e6 --set sweep.stop=3e6 --set sweep.step=2e4 \
        --set array.count=24 --set array.pitch=0.001";
    let grid = "--set grid.x=[-0.01,0.01] --set grid.y=[-0.01,0.01] --set grid.z=[0.03,0.07] --set grid.pitch=[0.001,0.001,0.001]";
    done(path, &format!("simulate flaw.csv -o cube.npz -q {instrument} --set medium.interface={steel}"));
    let info = done_json(path, "info cube.npz");
    assert_eq!(info["interface"]["sound_speed"], 5900.0, "{info}");
    let brightest = |cube: &str, more: &str| {
        done(path, &format!("reconstruct {cube} -o volume.npz {grid} {more}"));
        let (volume, meta) =
            holosonar::export::volume_npz::read_volume_npz(&path.join("volume.npz"), 1 << 30).unwrap();
        let (i, _) =
            volume.samples.iter().enumerate().max_by(|a, b| a.1.norm().total_cmp(&b.1.norm())).unwrap();
        (position_of(&volume.grid, i), f64::from(volume.peak()), meta)
    };
    let flaw = DVec3::new(0.006, -0.004, 0.05);
    let (found, peak, meta) = brightest("cube.npz", "");
    assert!(found.distance(flaw) < 1e-9 && (peak - 1.0).abs() < 1e-3, "{found} {peak}");
    assert_eq!(meta["interface"]["depth"], 0.02);
    // Without it, the flaw is nowhere near.
    let mut cube = DataCube::read(&path.join("cube.npz"), 1 << 30).unwrap();
    cube.instrument.interface = None;
    cube.write(&path.join("plain.npz")).unwrap();
    let (wrong, weak, _) = brightest("plain.npz", "");
    assert!(wrong.distance(flaw) > 0.005 && weak < 0.9, "{wrong} {weak}");
    // It can be told afterwards.
    let (found, _, _) = brightest("plain.npz", &format!("--set medium.interface={steel}"));
    assert!(found.distance(flaw) < 1e-9, "{found}");
    let told = run(path, &format!("plan plain.npz {grid} --set medium.interface={steel}"));
    assert_names(told.stdout, &["5900 m/s beyond z = 0.02 m", "one medium"]);

    let refused_with = |keys: &str, named: &[&str]| {
        let words = format!("simulate flaw.csv -o no.npz {instrument} --set medium.interface={keys}");
        refused(path, &words, 2, named);
    };
    refused_with("{depth=0.02,sound_speed=-1.0}", &["medium.interface", "-1", "steel"]);
    refused_with("{depth=0.0,sound_speed=5900.0}", &["medium.interface", "greater than 0"]);
    refused_with("{depht=0.1,sound_speed=5900.0}", &["depht", "depth"]);
    refused_with(&format!("{steel} --set array.source=[0.0,0.0,0.03]"), &["interface", "before it", "0.03"]);
    refused_with(&format!("{steel} --set medium.spreading=true"), &["medium.spreading", "interface"]);
    refused_with(&format!("{steel} --set detection.model=linear"), &["detection.model", "interface"]);
    let by =
        |method: &str| format!("reconstruct cube.npz -o no.npz {grid} --set reconstruct.method={method}");
    refused(path, &by("backprojection"), 2, &["backprojection", "medium] interface", "convolution"]);
    refused(path, &by("linear"), 2, &["linear", "medium] interface"]);
}
