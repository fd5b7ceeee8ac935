//! Transforms from the frame of a mesh file to that of the array: unit, up axis, scale, rotation and position.

use std::str::FromStr;

use glam::{DAffine3, DMat3, DVec3};

use super::OwnFrame;
use super::files::MeshFile;
use super::material::MaterialRule;
use super::triangle::Triangle;
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::files::extension;
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
/// The order is: unit, up axis (or the sensor's frame), scale (or `size`), rotation, and finally one of translation and
/// `fit`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LoadOptions {
    /// The file's unit of length. STL and PLY need it, unless `size` is given, and so does OBJ unless its header says
    /// `1 unit = ...`; glTF is in m.
    pub unit: Option<Unit>,
    /// The unit where neither `unit` nor the file says it, instead of an error.
    pub assumed_unit: Option<Unit>,
    /// The file's up axis; `None` for [`Up::Y`] with glTF and OBJ, [`Up::Z`] with STL and [`Up::None`] with PLY.
    pub up: Option<Up>,
    /// Factor on all lengths.
    pub scale: f64,
    /// Instead of `unit` and `scale`: the longest side of the mesh's bounding box before it is rotated, m.
    pub size: Option<f64>,
    /// Degrees about the array's x axis, then its y axis, then its z axis.
    pub rotate: DVec3,
    /// Displacement, m.
    pub translate: DVec3,
    /// Instead of `translate`: the centre of the bounding box is moved here, m.
    pub fit: Option<DVec3>,
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
            assumed_unit: None,
            up: None,
            scale: 1.0,
            size: None,
            rotate: DVec3::ZERO,
            translate: DVec3::ZERO,
            fit: None,
            sensor: None,
            materials: Vec::new(),
            memory: None,
        }
    }
}

with_fields! {
    LoadOptions {
        with_unit(unit: Option<Unit>),
        with_assumed_unit(assumed_unit: Option<Unit>),
        with_up(up: Option<Up>),
        with_scale(scale: f64),
        with_size(size: Option<f64>),
        with_rotate(rotate: DVec3),
        with_translate(translate: DVec3),
        with_fit(fit: Option<DVec3>),
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
        if let Some(size) = self.size {
            if !(size.is_finite() && size > 0.0) {
                let problem = format!("is {size} m; expected a finite length above 0");
                return Err(Error::input("size", problem));
            }
            if self.unit.is_some() || self.scale != 1.0 {
                return Err(Error::input("size", "replaces `unit` and `scale`; remove one"));
            }
        }
        let vectors = [("rotate", Some(self.rotate)), ("translate", Some(self.translate)), ("fit", self.fit)];
        for (name, vector) in vectors {
            if vector.is_some_and(|v| !v.is_finite()) {
                return Err(Error::input(name, "contains a number that is not finite"));
            }
        }
        if self.translate != DVec3::ZERO && self.fit.is_some() {
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

/// What a mesh file says of its own frame, and what was made of it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct MeshFrame {
    /// Metres per unit of the file's coordinates, with the scale; `None` where neither the file nor the options say it.
    pub metres_per_unit: Option<f64>,
    /// Sides of the bounding box along the file's own axes, in its own unit.
    pub size: DVec3,
    /// The up axis that was used; `None` where a sensor sets the axes.
    pub up: Option<Up>,
    /// Whether that is the default of the format.
    pub up_is_default: bool,
}

/// Where a mesh is placed by its size: takes the lower and upper corner of its bounding box, turned and in m, and gives the
/// place of the box's centre; `None` for where the options say.
pub(super) type Place<'a> = &'a mut dyn FnMut(DVec3, DVec3) -> Result<Option<DVec3>>;

/// The transform from the file's frame to the array's: unit, up, scale, rotate, then translate or fit.
///
/// # Errors
/// A file without a unit, and those of `place`.
pub(super) fn placement(
    own: &OwnFrame<'_>,
    triangles: &[Triangle],
    options: &LoadOptions,
    place: Place<'_>,
) -> Result<(DAffine3, MeshFrame)> {
    let vertices = || triangles.iter().flat_map(|t| t.vertices);
    let size = bounding_box(vertices()).map_or(DVec3::ZERO, |(low, high)| high - low);
    let longest = size.max_element();
    let stated = options.unit.map(Unit::metres).or(own.metres_per_unit).map(|metres| metres * options.scale);
    // A point has no size that could be changed.
    let sized = options.size.map(|wanted| if longest > 0.0 { wanted / longest } else { 1.0 });
    let metres_per_unit = sized.or(stated);
    let assumed = options.assumed_unit.map(|unit| unit.metres() * options.scale);
    let metres = metres_per_unit.or(assumed).ok_or_else(|| unit_needed(own.file, size))?;
    let up = options.up.unwrap_or(own.up);
    let to_array_axes = own.sensor.unwrap_or_else(|| DAffine3::from_mat3(up.rotation()));
    let turn = rotation(options.rotate);
    let oriented = DAffine3::from_mat3(turn * metres) * to_array_axes;
    // The box is that of the rotated mesh, not the rotated box of the mesh.
    let (low, high) = bounding_box(vertices().map(|v| oriented.transform_point3(v))).unwrap_or_default();
    let shift = match place(low, high)?.or(options.fit) {
        Some(centre) => centre - 0.5 * (low + high),
        None => options.translate,
    };
    let frame = MeshFrame {
        metres_per_unit,
        size,
        up: own.sensor.is_none().then_some(up),
        up_is_default: options.up.is_none(),
    };
    Ok((DAffine3::from_translation(shift) * oriented, frame))
}

/// The error for a file that does not say its unit, with what it would measure in each.
fn unit_needed(file: MeshFile<'_>, size: DVec3) -> Error {
    let longest = size.max_element();
    let in_units: Vec<String> = [Unit::Millimetre, Unit::Centimetre, Unit::Metre, Unit::Inch, Unit::Foot]
        .map(|unit| format!("{unit} ({})", metres(longest * unit.metres())))
        .into();
    file.refused(format!(
        "does not say the unit of its coordinates, as {} files seldom do; give `--unit` (in a run file: [scene] unit) as one \
         of {}, in which it would be that long; or its length itself, as in `--size 0.5m`",
        extension(file.path).to_uppercase(),
        in_units.join(", ")
    ))
}

/// A length with three digits, as people write it: `12.3 mm`, `1.23 m`.
pub(crate) fn metres(length: f64) -> String {
    let (value, unit) = match length {
        l if l >= 1e3 => (l / 1e3, "km"),
        l if l >= 1.0 => (l, "m"),
        l if l >= 0.1 => (l * 1e2, "cm"),
        l => (l * 1e3, "mm"),
    };
    let digits = if value >= 100.0 { 0 } else { 2 - value.max(1.0).log10() as usize };
    format!("{value:.digits$} {unit}")
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
#[path = "tests/placement.rs"]
mod tests;
