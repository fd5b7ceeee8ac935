//! Units, axes and places of mesh files.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;
use crate::progress::Silent;
use std::path::Path;

/// The placement of these triangles from a file in mm without axes of its own, with what `place` says.
fn placed(triangles: &[Triangle], options: &LoadOptions, place: Place<'_>) -> (DAffine3, MeshFrame) {
    let file = MeshFile { path: Path::new("a.ply"), options, observer: &Silent };
    let own = OwnFrame { file, metres_per_unit: Some(0.001), up: Up::None, sensor: None };
    placement(&own, triangles, options, place).unwrap()
}

fn place(point: DVec3, options: &LoadOptions) -> DVec3 {
    placed(&[], options, &mut |_, _| Ok(None)).0.transform_point3(1e3 * point)
}

#[test]
fn up_axes_map_as_documented_and_keep_the_hand() {
    let p = DVec3::new(1.0, 2.0, 3.0);
    let with = |up| LoadOptions { up: Some(up), ..LoadOptions::default() };
    assert_eq!(place(p, &with(Up::Y)), DVec3::new(1.0, -2.0, -3.0));
    assert_eq!(place(p, &with(Up::Z)), DVec3::new(1.0, -3.0, 2.0));
    assert_eq!(place(p, &with(Up::None)), p);
    for up in [Up::Y, Up::Z, Up::None] {
        assert_eq!(up.rotation().determinant(), 1.0);
    }
}

#[test]
fn scale_then_rotate_about_fixed_axes_then_translate() {
    let options = LoadOptions {
        scale: 2.0,
        rotate: DVec3::new(90.0, 90.0, 0.0),
        translate: DVec3::new(0.0, 0.0, 5.0),
        ..LoadOptions::default()
    };
    // y -> z by the rotation about x, then z -> x by the rotation about y.
    assert_eq!(place(DVec3::Y, &options), DVec3::new(2.0, 0.0, 5.0));
    let thirty = LoadOptions { rotate: DVec3::Z * 30.0, ..LoadOptions::default() };
    assert!((place(DVec3::X, &thirty) - DVec3::new(0.75_f64.sqrt(), 0.5, 0.0)).length() < 1e-15);
}

#[test]
fn fit_puts_the_centre_of_the_turned_box_there() {
    let t = [Triangle { vertices: [DVec3::ZERO, DVec3::X * 3.0, DVec3::Y * 4.0], material: 0 }];
    let centre = DVec3::new(0.0, 0.0, 2.0);
    let fit = |o: &LoadOptions, place: Place<'_>| {
        let (m, frame) = placed(&t, o, place);
        assert_eq!(frame.size, DVec3::new(3.0, 4.0, 0.0));
        let (low, high) = bounding_box(t[0].vertices.into_iter().map(|v| m.transform_point3(v))).unwrap();
        assert!((0.5 * (low + high) - centre).length() < 1e-15);
        high - low
    };
    let turned = LoadOptions { fit: Some(centre), rotate: DVec3::Z * 33.0, ..LoadOptions::default() };
    fit(&turned, &mut |_, _| Ok(None));
    // By the size of the turned box, whatever the options say.
    let quarter = LoadOptions { rotate: DVec3::Z * 90.0, size: Some(0.8), ..turned };
    let mut asked = DVec3::ZERO;
    let size = fit(&LoadOptions { fit: Some(DVec3::X), ..quarter }, &mut |low, high| {
        asked = high - low;
        Ok(Some(centre))
    });
    assert!((asked - DVec3::new(0.8, 0.6, 0.0)).length() < 1e-12 && (size - asked).length() < 1e-12);
}

#[test]
fn a_file_without_a_unit_is_refused_with_what_it_would_measure() {
    let options = LoadOptions::default();
    let file = MeshFile { path: Path::new("a.ply"), options: &options, observer: &Silent };
    let refused = unit_needed(file, DVec3::new(30.0, 127.0, 5.0)).to_string();
    assert_names(refused, &["a.ply", "--unit", "mm (12.7 cm)", "m (127 m)", "in (3.23 m)", "--size 0.5m"]);
    let lengths = [0.0, 0.00123, 0.0456, 0.999, 12.34, 999.0, 2500.0].map(metres);
    assert_eq!(lengths, ["0.00 mm", "1.23 mm", "45.6 mm", "99.9 cm", "12.3 m", "999 m", "2.50 km"]);
}

#[test]
fn words_are_read_and_contradictions_refused() {
    assert_eq!("in".parse::<Unit>().unwrap().metres(), 0.0254);
    assert_eq!("ft".parse::<Unit>().unwrap().metres(), 0.3048);
    let unknown = "yard".parse::<Unit>().unwrap_err().to_string();
    assert_names(unknown, &["yard", "m,", "cm", "mm", "in,", "ft"]);
    assert_eq!("camera:Front left".parse::<Sensor>().unwrap(), Sensor::Camera("Front left".into()));
    assert_eq!("node:a:b".parse::<Sensor>().unwrap(), Sensor::Node("a:b".into()));
    assert!("Front".parse::<Sensor>().is_err() && "camera:".parse::<Sensor>().is_err());
    let refused = |o: LoadOptions| o.check().unwrap_err().to_string();
    let default = LoadOptions::default;
    assert_names(refused(LoadOptions { scale: 0.0, ..default() }), &["scale", "0"]);
    assert_names(refused(LoadOptions { scale: f64::NAN, ..default() }), &["scale", "NaN"]);
    assert_names(refused(LoadOptions { rotate: DVec3::NAN, ..default() }), &["rotate", "finite"]);
    assert_names(refused(LoadOptions { size: Some(-1.0), ..default() }), &["size", "-1"]);
    let sized = LoadOptions { size: Some(1.0), unit: Some(Unit::Inch), ..default() };
    assert_names(refused(sized), &["size", "unit", "scale"]);
    let both = LoadOptions { fit: Some(DVec3::Z), translate: DVec3::Z, ..default() };
    assert_names(refused(both), &["fit", "translate"]);
}
