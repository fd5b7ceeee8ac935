//! Arrays that are not lattices, and predictions for any array compared with measurements.

use crate::binary::{done, done_json, json_file, refused, shipped, small};
use crate::named::assert_names;
use crate::support::{brightest, off_lattice, relative_difference, unit_reflector};
use glam::DVec3;
use holosonar::acquisition::{DataCube, Instrument, MicArray, SimulateOptions, Sweep, simulate};
use holosonar::config::RunFile;
use holosonar::grid::{Axis, Grid};
use holosonar::pipeline::{self, JobOptions};
use holosonar::psf::{PointSpread, point_spread};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::wave::Geometry;
use num_complex::Complex32;

/// A spiral and a random array of 256 microphones over one metre.
fn scattered() -> [MicArray; 2] {
    [
        MicArray::spiral(256, [1.0, 1.0], DVec3::ZERO).unwrap(),
        MicArray::random(256, [1.0, 1.0], DVec3::ZERO, None, 1).unwrap(),
    ]
}

fn grid(half: f64, count: usize, z: [f64; 2], depths: usize) -> Grid {
    let lateral = Axis { first: -half, pitch: 2.0 * half / (count - 1) as f64, count };
    let pitch = (z[1] - z[0]) / (depths - 1) as f64;
    Grid { x: lateral, y: lateral, z: Axis { first: z[0], pitch, count: depths } }
}

#[test]
fn scattered_arrays_image_a_point_as_the_direct_sum_does() {
    let p = off_lattice();
    let reflector = unit_reflector(p);
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 50.0).unwrap();
    let grid = grid(0.12, 25, [0.95, 1.08], 14);
    for array in scattered() {
        let instrument = Instrument::new(sweep.clone(), array);
        let cube = simulate(&reflector, &instrument, &SimulateOptions::default()).unwrap();
        let of =
            |method| reconstruct(&cube, &grid, &ReconstructOptions::new(method, Window::Taylor)).unwrap();
        let direct = of(Method::Direct).volume;
        for method in [Method::Convolution, Method::Backprojection] {
            let fast = of(method);
            assert_eq!(fast.method, method, "the fast way is taken");
            let difference = relative_difference(&fast.volume.samples, &direct.samples);
            assert!(difference < 1e-4, "{method:?}: {difference}");
            let (ix, iy, iz) = brightest(&fast.volume);
            let off = (grid.position(ix, iy, iz) - p).abs();
            assert!(off.cmple(DVec3::new(0.0051, 0.0051, 0.0051)).all(), "{method:?}: {off}");
            assert!((fast.volume.peak() - 1.0).abs() < 0.15, "{}", fast.volume.peak());
        }
    }
}

#[test]
fn scattered_arrays_image_the_corner_as_the_direct_sum_does() {
    for layout in ["spiral", "random"] {
        let overrides =
            [format!("array.layout={layout}"), "array.elements=256".to_owned(), "sweep.step=100".to_owned()];
        let run = RunFile::load(&small("corner.toml"), &overrides).unwrap();
        let cube = pipeline::simulate_scene(&run, &JobOptions::default()).unwrap();
        // Voxels of the scene's own pitch around the vertex and along a wall.
        let some = grid(0.2, 13, [1.9, 2.25], 20);
        let of = |method, tolerance| {
            let options = ReconstructOptions::new(method, Window::Taylor).with_tolerance(tolerance);
            reconstruct(&cube, &some, &options).unwrap()
        };
        let direct = of(Method::Direct, 1e-4).volume;
        let fast = of(Method::Convolution, 1e-5);
        assert_eq!(fast.method, Method::Convolution);
        let difference = relative_difference(&fast.volume.samples, &direct.samples);
        assert!(difference < 1e-4, "{layout}: {difference}");
        let usual = of(Method::Convolution, 1e-4);
        let error = relative_difference(&usual.volume.samples, &direct.samples) * f64::from(direct.peak());
        assert!(error <= usual.error_bound + 1e-6 * f64::from(direct.peak()), "{layout}: {error}");
    }
}

/// The whole pipeline, skeletons, depth and metrics included, on the corner as its own grid sees it.
#[test]
fn scattered_arrays_find_the_corner() {
    for layout in ["spiral", "random"] {
        let run = RunFile::load(&small("corner.toml"), &[format!("array.layout={layout}")]).unwrap();
        let outcome = pipeline::image_scene(&run, &JobOptions::default()).unwrap();
        let metrics = outcome.metrics().unwrap();
        assert!(metrics.completeness.unwrap() > 0.55, "{layout}: {metrics:?}");
        assert!(metrics.false_returns.unwrap() < 0.25, "{layout}: {metrics:?}");
        assert!(metrics.median_error.unwrap() < 0.0171, "{layout}: {metrics:?}");
    }
}

/// The point-spread function of an array at `p`.
fn spread(
    array: &MicArray,
    [start, stop]: [f64; 2],
    geometry: Geometry,
    window: Window,
    p: DVec3,
) -> PointSpread {
    let sweep = Sweep::stepped(start, stop, 50.0).unwrap();
    let instrument = Instrument::new(sweep, array.clone()).with_geometry(geometry);
    let scene = grid(0.5, 41, [1.0, 2.0], 60);
    point_spread(&instrument, &ReconstructOptions::new(Method::Auto, window), &scene, p).unwrap()
}

fn square(count: usize, extent: f64) -> MicArray {
    MicArray::rectangular([count; 2], [extent / (count - 1) as f64; 2], DVec3::ZERO).unwrap()
}

#[test]
fn predicted_widths_grating_lobes_and_levels_are_those_measured() {
    const WIDE: [f64; 2] = [10_000.0, 20_000.0];
    const NARROW: [f64; 2] = [18_000.0, 20_000.0];
    let [spiral, random] = scattered();
    let middle = DVec3::new(0.0, 0.0, 1.5);
    let aside = DVec3::new(0.35, -0.2, 1.3);
    let mut grating_lobes = 0;
    for (name, array, band, geometry, window, p) in [
        ("grid", square(15, 1.0), WIDE, Geometry::ORIGIN, Window::None, middle),
        ("narrow", square(15, 1.0), NARROW, Geometry::ORIGIN, Window::None, middle),
        ("aside", square(15, 1.0), WIDE, Geometry::ORIGIN, Window::Taylor, aside),
        ("scan", square(15, 0.5), NARROW, Geometry::Monostatic, Window::Taylor, middle),
        ("spiral", spiral, WIDE, Geometry::ORIGIN, Window::Taylor, aside),
        ("random", random, NARROW, Geometry::ORIGIN, Window::None, middle),
    ] {
        let spread = spread(&array, band, geometry, window, p);
        assert!((spread.amplitude - 1.0).abs() < 0.01, "{name}: {}", spread.amplitude);
        for width in spread.widths {
            for (measured, predicted) in
                [(width.at_3_db, width.predicted_at_3_db), (width.at_6_db, width.predicted_at_6_db)]
            {
                let ratio = measured.unwrap() / predicted.unwrap();
                assert!((ratio - 1.0).abs() < 0.12, "{name}: {width:?}");
            }
        }
        for grating_lobe in &spread.grating_lobes {
            grating_lobes += 1;
            let [predicted, measured] = grating_lobe.offset;
            assert!((measured / predicted - 1.0).abs() < 0.03, "{name}: {grating_lobe:?}");
            assert!(
                (grating_lobe.measured.level_db - grating_lobe.predicted.level_db).abs() < 6.0,
                "{name}: {grating_lobe:?}"
            );
        }
        let peak = spread.peak_sidelobe.unwrap();
        let predicted = spread.predicted_peak_sidelobe_db.unwrap();
        assert!((peak.level_db - predicted).abs() < 6.0, "{name}: {peak:?} against {predicted}");
        assert_eq!(spread.grating_lobes.is_empty(), ["spiral", "random"].contains(&name), "{name}");
    }
    assert!(grating_lobes >= 12, "{grating_lobes}");
}

/// The grating lobes of a point at (0.76, 3.15) before 15 microphones over 2 m with 2 kHz, measured in the image of another program
/// (the direct sum of Eq. 13 in NumPy, on voxels of 1 cm): at x = 0.35 and 1.16 m, -4.5 and -5.8 dB. Theory has them where
/// the sine of the direction is off by k λ_c/d, of which λ_c z/d = 0.40 m aside is the first order.
#[test]
fn grating_lobes_are_where_an_independent_study_found_them() {
    let row = MicArray::rectangular([15, 1], [2.0 / 14.0, 1.0], DVec3::ZERO).unwrap();
    let p = DVec3::new(0.76, 0.0, 3.15);
    let spread = spread(&row, [18_000.0, 20_000.0], Geometry::ORIGIN, Window::None, p);
    for (order, x, level) in [(-1, 0.35, -4.5), (1, 1.16, -5.8)] {
        let grating_lobe = spread.grating_lobes.iter().find(|g| g.order == order).unwrap();
        assert!((grating_lobe.measured.position[0] - x).abs() < 0.03, "{grating_lobe:?}");
        assert!((grating_lobe.measured.level_db - level).abs() < 2.5, "{grating_lobe:?}");
    }
    assert!(
        spread.widths[1].at_3_db.is_none() && spread.widths[0].at_3_db.is_some(),
        "a row has no resolution in y"
    );
}

#[test]
fn every_suggestion_fixes_what_it_says() {
    let overrides = |more: &[String]| {
        let all = [&["detection.kind=in-phase".to_owned(), "sweep.step=100".to_owned()], more].concat();
        RunFile::load(&small("corner.toml"), &all).unwrap()
    };
    let forecast =
        |more: &[String]| pipeline::forecast_scene(&overrides(more), &JobOptions::default()).unwrap();
    let first = forecast(&[]);
    let sign = |mends: &str| if mends == "aliasing" { "alias" } else { "unambiguous" };
    let mut seen = Vec::new();
    for suggestion in &first.design.suggestions {
        let after = forecast(&suggestion.set);
        seen.push(suggestion.fixes);
        if ["voxels", "speed"].contains(&suggestion.fixes) {
            assert!(!after.design.suggestions.iter().any(|s| s.fixes == suggestion.fixes), "{suggestion:?}");
            continue;
        }
        let sign = sign(suggestion.fixes);
        assert!(first.warnings.iter().any(|w| w.contains(sign)), "{sign}: {:?}", first.warnings);
        assert!(!after.warnings.iter().any(|w| w.contains(sign)), "{suggestion:?}: {:?}", after.warnings);
    }
    for mends in ["aliasing", "ambiguity", "voxels"] {
        assert!(seen.contains(&mends), "{seen:?}");
    }
}

#[test]
fn voxels_beside_the_lattice_are_told_of_a_faster_pitch() {
    let pitch = "grid.pitch=[0.0170,0.0165,0.02]".to_owned();
    let forecast = |more: &[String]| {
        let run = RunFile::load(&small("corner.toml"), more).unwrap();
        pipeline::forecast_scene(&run, &JobOptions::default()).unwrap()
    };
    let operations = |forecast: &pipeline::Forecast| forecast.methods[forecast.chosen].operations;
    // A tolerance of 0 allows no nodes and no spreading.
    let slow = forecast(&[pitch, "reconstruct.tolerance=0".to_owned()]);
    let Some(speed) = slow.design.suggestions.iter().find(|s| s.fixes == "speed") else {
        panic!("{:?}", slow.design.suggestions)
    };
    let fast = forecast(&[&speed.set[..], &["reconstruct.tolerance=0".to_owned()]].concat());
    assert!(operations(&slow) > 10.0 * operations(&fast), "{speed:?}");
    assert!(fast.design.suggestions.iter().all(|s| s.fixes != "speed"));
}

#[test]
fn a_sweep_compares_layouts_in_one_command() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("corner.toml");
    let words = format!(
        "plan {} --set array.elements=256 --set reconstruct.window=taylor --sweep array.layout=grid,spiral,random --sweep sweep.start=10000,18000 -o out",
        scene.display()
    );
    let sweep = done_json(folder.path(), &words);
    let rows = sweep["combinations"].as_array().unwrap();
    assert_eq!(rows.len(), 6);
    for row in rows {
        assert_eq!(row["design"]["microphones"], 256, "{row}");
    }
    let peak = |row: usize| rows[row]["design"]["peak_sidelobe_db"].as_f64().unwrap();
    assert!(peak(0) > peak(2) + 5.0 && peak(0) > peak(4) + 5.0, "a grid has high grating lobes: {sweep}");
    assert_eq!(rows[0]["design"]["verdict"], "ghosts");
    assert_eq!(rows[2]["design"]["verdict"], "scattered");
    assert!(std::fs::read(folder.path().join("out/sweep.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(json_file(&folder.path().join("out/sweep.json"))["keys"], sweep["keys"]);
    let table = done(folder.path(), &words);
    let heading: Vec<&str> = table.lines().next().unwrap().split_whitespace().collect();
    assert_eq!(heading[..2], ["array.layout", "sweep.start"], "{table}");
    for layout in ["grid", "spiral", "random"] {
        assert_eq!(table.lines().filter(|line| line.starts_with(layout)).count(), 2, "{table}");
    }
    // One value that makes no job leaves the others; none that does is an error.
    let some = done_json(folder.path(), &format!("plan {} --sweep sweep.step=30,40", scene.display()));
    assert_names(some["combinations"][0]["refused"].as_str().unwrap(), &["sweep.step", "30"]);
    assert!(some["combinations"][1]["design"].is_object());
    for (words, parts) in [
        ("--sweep sweep.step=30", &["sweep.step", "30"][..]),
        ("--sweep sweep.stop", &["--sweep", "KEY=FROM:TO:STEP"]),
        ("--sweep array.size=1,2", &["`size`", "[array]"]),
        ("--sweep array.extent=1:2:0.00001", &["--sweep", "array.extent=1:2:0.00001", "50000"]),
    ] {
        refused(folder.path(), &format!("plan {} {words}", scene.display()), 2, parts);
    }
}

#[test]
fn psf_reports_and_draws_point_spread_functions() {
    let folder = tempfile::tempdir().unwrap();
    let scene = shipped("point.toml");
    let words = format!("psf {} --at -0.02,0.03,1 -o out", scene.display());
    let point = &done_json(folder.path(), &words)["points"][0];
    let ratio = |axis: usize| {
        let width = &point["widths"][axis];
        width["at_3_db"].as_f64().unwrap() / width["predicted_at_3_db"].as_f64().unwrap()
    };
    assert!((0..3).all(|axis| (ratio(axis) - 1.0).abs() < 0.12), "{point}");
    assert!(std::fs::read(folder.path().join("out/psf.png")).unwrap().starts_with(b"\x89PNG"));
    let text = done(folder.path(), &format!("psf {} --at 0,0,1", scene.display()));
    assert_names(text, &["0.000, 0.000, 1.000 m"]);
    refused(folder.path(), &format!("psf {} --at 0,0", scene.display()), 2, &["--at 0,0", "x,y,z"]);
    refused(
        folder.path(),
        &format!("psf {} --at 0,0,-1", scene.display()),
        2,
        &["--at", "0, 0, -1", "array"],
    );
}

#[test]
fn an_instrument_without_a_speed_of_sound_or_a_speaker_gives_no_path_a_phase() {
    let axis = Axis { first: -0.02, pitch: 0.02, count: 3 };
    let grid = Grid { x: axis, y: axis, z: Axis { first: 0.5, ..axis } };
    let one = unit_reflector(DVec3::Z);
    let array = MicArray::rectangular([3, 2], [0.02; 2], DVec3::ZERO).unwrap();
    let instrument = Instrument::new(Sweep::stepped(10e3, 10.4e3, 100.0).unwrap(), array);
    let nowhere = Geometry::FixedSource { source: DVec3::NAN };
    let speeds = [0.0, -343.0, f64::NAN, f64::INFINITY].map(|c| instrument.clone().with_sound_speed(c));
    for bad in speeds.into_iter().chain([instrument.clone().with_geometry(nowhere)]) {
        let simulated = simulate(&one, &bad, &SimulateOptions::default()).map(drop);
        let cube = DataCube::new(bad, vec![Complex32::ONE; 30]).unwrap();
        let imaged = reconstruct(&cube, &grid, &ReconstructOptions::default()).map(drop);
        for result in [simulated, imaged] {
            let error = result.unwrap_err();
            assert!(error.exit_status() == 2 && error.to_string().starts_with("instrument: "), "{error}");
        }
    }
}
