//! Transforms from the frame of a mesh file to that of the array: unit, up axis, scale, rotation and position.

use std::str::FromStr;

use glam::{DAffine3, DMat3, DVec3};

use super::material::MaterialRule;
use super::triangle::Triangle;
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::text::quoted;
use crate::wave::bounding_box;
use crate::with_fields::with_fields;

choice! {
    /// Unit of length of a mesh file.
    pub enum Unit: "unit" {
        /// 1 m.
        Metre = "m",
        /// 0.01 m.
        Centimetre = "cm",
        /// 0.001 m.
        Millimetre = "mm",
        /// 0.0254 m.
        Inch = "in",
        /// 0.3048 m.
        Foot = "ft",
    }
}

impl Unit {
    /// Its length in m.
    pub fn metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 0.01,
            Self::Millimetre => 0.001,
            Self::Inch => 0.0254,
            Self::Foot => 0.3048,
        }
    }
}

choice! {
    /// Which axis of the mesh points up.
    pub enum Up: "up axis" {
        /// +y is up and +z points to the viewer, as in glTF: (x, y, z) becomes (x, -y, -z).
        Y = "y",
        /// +z is up and +y points away from the viewer, as in CAD and Blender: (x, y, z) becomes (x, -z, y).
        Z = "z",
        /// The mesh is in the array's frame already.
        None = "none",
    }
}

impl Up {
    /// The rotation that takes the mesh's axes to the array's.
    fn rotation(self) -> DMat3 {
        match self {
            Self::Y => DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
            Self::Z => DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y),
            Self::None => DMat3::IDENTITY,
        }
    }
}

/// Where in a glTF file the array is placed. It looks as a glTF camera there does: along -z, with +y up.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sensor {
    /// At the camera of this name, or at the node of this name that has a camera.
    Camera(String),
    /// At the node of this name.
    Node(String),
}

impl FromStr for Sensor {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text.split_once(':') {
            Some(("camera", name)) if !name.is_empty() => Ok(Self::Camera(name.to_owned())),
            Some(("node", name)) if !name.is_empty() => Ok(Self::Node(name.to_owned())),
            _ => Err(Error::input(
                "sensor",
                format!("`{}` must have the form camera:NAME or node:NAME", quoted(text)),
            )),
        }
    }
}

/// How a mesh file is read and placed in front of the array.
///
/// The order is: unit, up axis (or the sensor's frame), scale, rotation, and finally one of translation, `fit` or
/// `fit_by_diagonal`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LoadOptions {
    /// The file's unit of length. STL and PLY need it, and so does OBJ unless its header says `1 unit = ...`; glTF is
    /// in m.
    pub unit: Option<Unit>,
    /// The file's up axis; `None` for [`Up::Y`] with glTF and [`Up::None`] with the other formats.
    pub up: Option<Up>,
    /// Factor on all lengths.
    pub scale: f64,
    /// Degrees about the array's x axis, then its y axis, then its z axis.
    pub rotate: DVec3,
    /// Displacement, m.
    pub translate: DVec3,
    /// Instead of `translate`: the centre of the bounding box is moved here, m.
    pub fit: Option<DVec3>,
    /// Instead of `translate`: the centre of the bounding box is moved to (0, 0, k × the box's diagonal).
    pub fit_by_diagonal: Option<f64>,
    /// glTF only: the array is placed at this camera or node, and `up` does not apply.
    pub sensor: Option<Sensor>,
    /// Acoustic materials by name; the first rule that matches overrides the file.
    pub materials: Vec<MaterialRule>,
    /// Maximum number of bytes for the file, and then for its triangles and their tree at
    /// [`BYTES_PER_TRIANGLE`](super::BYTES_PER_TRIANGLE) each; a mesh that needs more is refused before the memory is
    /// allocated. `None` for no limit but that of 50 million triangles.
    pub memory: Option<u64>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            unit: None,
            up: None,
            scale: 1.0,
            rotate: DVec3::ZERO,
            translate: DVec3::ZERO,
            fit: None,
            fit_by_diagonal: None,
            sensor: None,
            materials: Vec::new(),
            memory: None,
        }
    }
}

with_fields! {
    LoadOptions {
        with_unit(unit: Option<Unit>),
        with_up(up: Option<Up>),
        with_scale(scale: f64),
        with_rotate(rotate: DVec3),
        with_translate(translate: DVec3),
        with_fit(fit: Option<DVec3>),
        with_fit_by_diagonal(fit_by_diagonal: Option<f64>),
        with_sensor(sensor: Option<Sensor>),
        with_materials(materials: Vec<MaterialRule>),
        with_memory(memory: Option<u64>),
    }
}

impl LoadOptions {
    /// Refuses invalid numbers and contradictory positions.
    pub(super) fn check(&self) -> Result<()> {
        if !(self.scale.is_finite() && self.scale > 0.0) {
            let problem = format!("is {}; expected a finite number above 0", self.scale);
            return Err(Error::input("scale", problem));
        }
        let vectors = [("rotate", Some(self.rotate)), ("translate", Some(self.translate)), ("fit", self.fit)];
        for (name, vector) in vectors {
            if vector.is_some_and(|v| !v.is_finite()) {
                return Err(Error::input(name, "contains a number that is not finite"));
            }
        }
        if self.fit_by_diagonal.is_some_and(|k| !k.is_finite()) {
            return Err(Error::input("fit", "has a factor for the diagonal that is not finite"));
        }
        let places = [self.translate != DVec3::ZERO, self.fit.is_some(), self.fit_by_diagonal.is_some()];
        if places.into_iter().filter(|&given| given).count() > 1 {
            return Err(Error::input(
                "fit",
                "`fit` and `translate` must not both be given: each places the mesh; remove one",
            ));
        }
        if self.sensor.is_some() && self.up.is_some() {
            return Err(Error::input("up", "has no meaning with `sensor`, which sets the axes; remove one"));
        }
        Ok(())
    }
}

/// The transform from the file's frame to the array's: unit, up, scale, rotate, then translate or fit.
pub(super) fn placement(
    triangles: &[Triangle],
    metres_per_unit: f64,
    default_up: Up,
    sensor: Option<DAffine3>,
    options: &LoadOptions,
) -> DAffine3 {
    let to_metres = DAffine3::from_scale(DVec3::splat(metres_per_unit));
    let to_array_axes =
        sensor.unwrap_or_else(|| DAffine3::from_mat3(options.up.unwrap_or(default_up).rotation()));
    let turn = rotation(options.rotate) * options.scale;
    let oriented = DAffine3::from_mat3(turn) * to_array_axes * to_metres;
    let shift = if options.fit.is_none() && options.fit_by_diagonal.is_none() {
        options.translate
    } else {
        // The box is that of the rotated mesh, not the rotated box of the mesh.
        let corners = triangles.iter().flat_map(|t| t.vertices).map(|v| oriented.transform_point3(v));
        let (low, high) = bounding_box(corners).unwrap_or_default();
        let by_diagonal = options.fit_by_diagonal.map(|k| DVec3::Z * k * (high - low).length());
        options.fit.or(by_diagonal).unwrap_or_default() - 0.5 * (low + high)
    };
    DAffine3::from_translation(shift) * oriented
}

/// Rotation by `degrees` about the fixed axes x, then y, then z. Quarter turns are exact.
fn rotation(degrees: DVec3) -> DMat3 {
    let (sx, cx) = sine_and_cosine(degrees.x);
    let (sy, cy) = sine_and_cosine(degrees.y);
    let (sz, cz) = sine_and_cosine(degrees.z);
    let about_x = DMat3::from_cols(DVec3::X, DVec3::new(0.0, cx, sx), DVec3::new(0.0, -sx, cx));
    let about_y = DMat3::from_cols(DVec3::new(cy, 0.0, -sy), DVec3::Y, DVec3::new(sy, 0.0, cy));
    let about_z = DMat3::from_cols(DVec3::new(cz, sz, 0.0), DVec3::new(-sz, cz, 0.0), DVec3::Z);
    about_z * about_y * about_x
}

/// sin and cos of an angle in degrees, exact at multiples of 90°, so that a mesh rotated by them keeps its
/// axis-aligned faces and round coordinates.
fn sine_and_cosine(degrees: f64) -> (f64, f64) {
    match degrees.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        other => other.to_radians().sin_cos(),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn place(point: DVec3, options: &LoadOptions) -> DVec3 {
        placement(&[], 1.0, Up::None, None, options).transform_point3(point)
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
        let fit = |o: &LoadOptions| {
            let m = placement(&t, 0.001, Up::None, None, o);
            bounding_box(t[0].vertices.into_iter().map(|v| m.transform_point3(v))).unwrap()
        };
        let centre = DVec3::new(0.0, 0.0, 2.0);
        let (low, high) =
            fit(&LoadOptions { fit: Some(centre), rotate: DVec3::Z * 33.0, ..LoadOptions::default() });
        assert!((0.5 * (low + high) - centre).length() < 1e-15);
        let (low, high) = fit(&LoadOptions { fit_by_diagonal: Some(2.0), ..LoadOptions::default() });
        assert!((0.5 * (low + high) - DVec3::new(0.0, 0.0, 0.010)).length() < 1e-15);
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
        let both = LoadOptions { fit: Some(DVec3::Z), translate: DVec3::Z, ..default() };
        assert_names(refused(both), &["fit", "translate"]);
    }
}
