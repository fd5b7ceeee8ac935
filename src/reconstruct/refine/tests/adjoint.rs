//! The model against literal sums, and Eq. 13 as its adjoint, for arrays and grids of all kinds.

use super::*;

/// Arrays and grids of every kind that the convolution treats in its own way.
fn cases() -> Vec<(&'static str, Instrument, Grid)> {
    let lattice = |count, pitch: f64| MicArray::rectangular(count, [pitch; 2], DVec3::ZERO).unwrap();
    let cube = |x: Axis, y: Axis| Grid { x, y, z: axis(0.6, 0.011, 17) };
    let aside: Vec<DVec3> = random(23, 7)
        .iter()
        .map(|at| DVec3::new(0.11 * f64::from(at.re), 0.09 * f64::from(at.im) + 0.05, 0.0))
        .collect();
    let on_line = MicArray::rectangular([9, 1], [0.02, 0.02], DVec3::ZERO).unwrap();
    let fixed = |array| Instrument::new(sweep(100.0), array);
    let pair = |array, offset: [f64; 3]| fixed(array).with_geometry(Geometry::Pair { offset: offset.into() });
    let several = |array| {
        let place = |i: usize| DVec3::new(0.2, 0.3 - 0.25 * i as f64, -0.02 * i as f64);
        fixed(array).with_sources(&[0, 1, 2].map(place)).unwrap()
    };
    let steel = Some(Interface { depth: 0.63, sound_speed: 800.0 });
    let even = cube(axis(-0.15, 0.03, 11), axis(-0.12, 0.03, 9));
    vec![
        ("even", fixed(lattice([6, 5], 0.03)), even),
        ("on nodes", fixed(lattice([5, 5], 0.03)), even),
        ("aside", fixed(lattice([6, 5], 0.03)), cube(axis(0.237, 0.03, 7), axis(-0.1, 0.03, 9))),
        ("finer voxels", fixed(lattice([5, 4], 0.04)), cube(axis(-0.11, 0.02, 12), axis(-0.05, 0.02, 6))),
        ("finer array", fixed(lattice([9, 8], 0.015)), cube(axis(-0.15, 0.03, 11), axis(-0.1, 0.03, 8))),
        ("no lattice", fixed(lattice([6, 5], 0.031)), even),
        ("scattered", fixed(MicArray::from_positions(aside).unwrap()), even),
        ("scan", fixed(lattice([6, 5], 0.03)).with_geometry(Geometry::Monostatic), even),
        ("pair", pair(lattice([6, 5], 0.03), [0.06, 0.0, 0.0]), even),
        ("pair askew", pair(lattice([6, 5], 0.03), [0.05, -0.02, 0.04]), even),
        ("pairs on no lattice", pair(lattice([6, 5], 0.031), [0.0, 0.1, 0.0]), even),
        ("pair in two media", pair(lattice([6, 5], 0.03), [0.05, 0.0, 0.0]).with_interface(steel), even),
        (
            "pair on a line",
            pair(on_line.clone(), [0.05, 0.03, 0.0]),
            cube(axis(-0.14, 0.03, 9), axis(0.0, 0.03, 1)),
        ),
        ("in phase", fixed(lattice([6, 5], 0.03)).with_detection(Detection::InPhase), even),
        ("two media", fixed(lattice([6, 5], 0.03)).with_interface(steel), even),
        (
            "line in two media",
            fixed(on_line.clone()).with_interface(steel),
            cube(axis(-0.15, 0.02, 16), axis(0.0, 0.03, 1)),
        ),
        ("several", several(lattice([6, 5], 0.03)), even),
        ("several, finer voxels", several(lattice([5, 4], 0.04)), cube(axis(-0.11, 0.02, 12), even.y)),
        ("several, finer array", several(lattice([9, 8], 0.015)), even),
        ("several, no lattice", several(lattice([6, 5], 0.031)), even),
        ("several in phase", several(lattice([4, 5], 0.03)).with_detection(Detection::InPhase), even),
        ("several in two media", several(lattice([6, 5], 0.03)).with_interface(steel), even),
        ("several on a line", several(on_line.clone()), cube(axis(-0.15, 0.02, 16), axis(0.0, 0.03, 1))),
        ("line", fixed(on_line.clone()), cube(axis(-0.15, 0.02, 16), axis(0.0, 0.03, 1))),
        (
            "scanned line",
            fixed(on_line).with_geometry(Geometry::Monostatic),
            cube(axis(-0.14, 0.03, 9), axis(0.0, 0.03, 1)),
        ),
    ]
}

/// `<KA, m> = <A, K*m>`, with the first from |m|², |KA|² and |m − KA|².
fn assert_adjoint(
    name: &str,
    operator: &Operator<'_>,
    cube: &DataCube,
    voxels: &[Complex32],
    echoes: &[Complex32],
) {
    let mut image = Volume { grid: *operator.grid, samples: Vec::new() };
    let (_, energy) = operator.image(&mut &*cube, None, &mut image, &Silent).unwrap();
    let whole = operator.power(echoes);
    let of_samples = 0.5 * (energy + whole - operator.power_left(&mut &*cube, echoes).unwrap());
    let pairs = voxels.iter().zip(&image.samples);
    let of_voxels: f64 = pairs.map(|(a, b)| f64::from((a * b.conj()).re)).sum();
    let bound = 1e-5 * (whole * energy).sqrt();
    assert!((of_samples - of_voxels).abs() < bound, "{name}: {of_samples:e} is not {of_voxels:e}");
}

#[test]
fn echoes_are_the_literal_sums_and_their_adjoint_is_eq_13() {
    for (name, instrument, grid) in cases() {
        let voxels = random(grid.voxel_count() as usize, 3);
        let literal = literal_echoes(&instrument, &grid, &voxels);
        assert_eq!(literal.len() as u64 * 8, instrument.cube_bytes());
        let mut samples = random(literal.len(), 5);
        if instrument.detection == Detection::InPhase {
            for m in &mut samples {
                m.im = 0.0;
            }
        }
        let cube = DataCube::new(instrument.clone(), samples.clone()).unwrap();
        with_operator(&instrument, &grid, &options(Window::None), |operator| {
            let echoes = operator.echo(&voxels, &Silent).unwrap();
            // |m − KA|² of m = KA is only rounding and the tolerance.
            let own = DataCube::new(instrument.clone(), literal.clone()).unwrap();
            let left = operator.power_left(&mut &own, &echoes).unwrap();
            let whole = operator.power(&echoes);
            assert!(left.sqrt() < 2e-5 * whole.sqrt(), "{name}: {left:e} of {whole:e}");
            assert_adjoint(name, operator, &cube, &voxels, &echoes);
        });
    }
}

#[test]
fn voxels_that_are_interpolated_have_an_adjoint_too() {
    let array = MicArray::rectangular([9, 7], [0.05; 2], DVec3::new(0.01, -0.02, 0.0)).unwrap();
    let instrument = Instrument::new(sweep(300.0), array);
    let wide = Grid { x: axis(-0.11, 0.004, 50), y: axis(-0.09, 0.0037, 40), z: axis(0.7, 0.003, 40) };
    let deep = Grid { x: axis(-0.1, 0.025, 9), y: axis(-0.1, 0.025, 8), z: axis(0.7, 0.002, 70) };
    for grid in [wide, deep] {
        let options = options(Window::None).with_tolerance(1e-4);
        // Few, since the literal sum takes long.
        let mut voxels = vec![Complex32::ZERO; grid.voxel_count() as usize];
        voxels.iter_mut().step_by(997).zip(random(200, 61)).for_each(|(voxel, a)| *voxel = a);
        let literal = literal_echoes(&instrument, &grid, &voxels);
        let own = DataCube::new(instrument.clone(), literal.clone()).unwrap();
        let cube = DataCube::new(instrument.clone(), random(literal.len(), 62)).unwrap();
        with_operator(&instrument, &grid, &options, |operator| {
            assert!(operator.interpolates(), "{:?}", grid.shape());
            let echoes = operator.echo(&voxels, &Silent).unwrap();
            let whole = operator.power(&echoes);
            let left = operator.power_left(&mut &own, &echoes).unwrap();
            assert!(left.sqrt() < 2e-4 * whole.sqrt(), "{left:e} of {whole:e}");
            assert_adjoint("interpolated", operator, &cube, &voxels, &echoes);
            // Some depths alone.
            let some = 10..17;
            let mut alone = voxels.clone();
            let plane = grid.plane_len();
            alone
                .iter_mut()
                .enumerate()
                .filter(|(i, _)| !some.contains(&(i / plane)))
                .for_each(|(_, a)| *a = Complex32::ZERO);
            assert_eq!(
                operator.echo_of(some, &voxels, &Silent).unwrap(),
                operator.echo(&alone, &Silent).unwrap()
            );
        });
    }
}

#[test]
fn what_is_left_of_the_samples_is_imaged_with_the_windows_weights() {
    let (_, instrument, grid) = cases().swap_remove(0);
    let voxels = random(grid.voxel_count() as usize, 11);
    let samples = random(instrument.sweep.len() * instrument.array.len(), 12);
    let cube = DataCube::new(instrument.clone(), samples.clone()).unwrap();
    let options = options(Window::Hann);
    with_operator(&instrument, &grid, &options, |operator| {
        let echoes = operator.echo(&voxels, &Silent).unwrap();
        let mut image = Volume { grid, samples: Vec::new() };
        operator.image(&mut &cube, Some(&echoes), &mut image, &Silent).unwrap();
        let literal = literal_echoes(&instrument, &grid, &voxels);
        let left = samples.iter().zip(&literal).map(|(m, echo)| m - echo).collect();
        let left = DataCube::new(instrument.clone(), left).unwrap();
        let plain = reconstruct(&left, &grid, &options.with_refine(None)).unwrap().volume;
        let differences: Vec<_> = image.samples.iter().zip(&plain.samples).map(|(a, b)| a - b).collect();
        assert!(norm(&differences) < 2e-5 * norm(&plain.samples), "{:e}", norm(&differences));
    });
}
