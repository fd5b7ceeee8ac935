//! Figure 7: what too few microphones do, and the rule that foretells it.
//!
//! Microphones d apart see a direction sin θ and sin θ − kλ/d alike, so an echo at p has ghosts at
//! `x_k = |p|·(p̂_x − kλ/d)`, λ at the middle of the band, as classical theory says. The paper looked for
//! `(2^N − 1)/x = 7.5 m`, which is the microphones' number *per metre*, a sampling frequency and no distance.

use super::scene::{CROSSING, cube, cube_of, pitch, reflectors};
use super::{CASES, Case, amplitudes, nonlinear};
use crate::acquisition::PropagationModel::Exact;
use crate::error::Result;
use crate::grid::{Axis, Grid};
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use crate::reflectors::Reflectors;
use crate::wave::DEFAULT_SOUND_SPEED;
use num_complex::Complex32;
use serde::Serialize;

/// A copy of a point target that is not there.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Ghost {
    /// How many times λ/d it is turned away.
    pub(super) order: i32,
    /// Where the rule puts it, m.
    pub(super) predicted_x: f64,
    /// Where the image's maximum around there is, m.
    pub(super) measured_x: f64,
    /// `−20 log₁₀ max(1, |k|(N−1)B/f_c)`: about how strong it is, dB below the target.
    pub(super) predicted_db: f64,
    /// How strong it is, dB below the target.
    pub(super) measured_db: f64,
}

/// The scene, and a point where its lines cross, with a number of microphones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Aliasing {
    /// Microphones over 2 m.
    pub(super) microphones: usize,
    /// λ/d: the turn between ghosts, in sin θ.
    pub(super) turn: f64,
    /// λ|p|/d: their distance at the crossing, m.
    pub(super) spacing: f64,
    /// Ghosts of a point at the crossing, nearest first.
    pub(super) ghosts: Vec<Ghost>,
    /// Greatest amplitude away from the lines of the scene, against the root mean square on them, dB.
    pub(super) off_lines_db: f64,
    /// The scene's image, `[z, x]`, greatest 1.
    #[serde(skip)]
    pub(super) image: Vec<f32>,
}

/// Microphones of the figure's panels, and the full row.
const COUNTS: [usize; 4] = [15, 31, 63, 255];

/// Above this, against the lines, what is off the lines is seen: they fade to about −13 dB themselves.
const SEEN_DB: f64 = -6.0;

/// Ghosts of higher order are not looked for: they are far aside and weak.
const ORDERS: i32 = 2;

impl Aliasing {
    /// Whether ghosts show in the picture of the scene.
    pub(super) fn shows_ghosts(&self) -> bool {
        self.off_lines_db > SEEN_DB
    }
}

/// The images with few microphones, and ghosts of a point.
pub(super) fn study(observer: &dyn Observer) -> Result<Vec<Aliasing>> {
    stage(observer, "aliasing", COUNTS.len() as u64, || {
        let of = |microphones: usize| {
            let aliasing = one(&Case { microphones, ..CASES[2] })?;
            advance(observer, 1).map(|()| aliasing)
        };
        COUNTS.into_iter().map(of).collect()
    })
}

fn one(case: &Case) -> Result<Aliasing> {
    let (image, _) = nonlinear(&cube(case, Exact)?)?;
    let wavelength = DEFAULT_SOUND_SPEED / (20_000.0 - case.bandwidth / 2.0);
    let turn = wavelength / pitch(case);
    Ok(Aliasing {
        microphones: case.microphones,
        turn,
        spacing: turn * CROSSING.length(),
        ghosts: ghosts(case, turn)?,
        off_lines_db: off_lines_db(&image)?,
        image,
    })
}

/// Where a point's ghosts are looked for: beside the picture too, and ± 15 cm of depth, since they bend.
fn beside() -> Grid {
    let axis = |first: f64, pitch: f64, count: usize| Axis { first, pitch, count };
    Grid { x: axis(-1.4, 0.005, 661), y: axis(0.0, 1.0, 1), z: axis(3.0, 0.01, 31) }
}

fn ghosts(case: &Case, turn: f64) -> Result<Vec<Ghost>> {
    let point = Reflectors::new(vec![CROSSING], vec![Complex32::ONE])?;
    let (grid, options) = (beside(), ReconstructOptions::new(Method::Auto, Window::None));
    let cube = cube_of(&point, case, Exact)?;
    let volume = reconstruct(&cube, &grid, &options)?.volume;
    let (image, peak) = (amplitudes(&volume.samples), f64::from(volume.peak()));
    let (range, smear) =
        (CROSSING.length(), (case.microphones - 1) as f64 * case.bandwidth / cube.instrument.sweep.centre());
    let mut found = Vec::new();
    for order in (1..=ORDERS).flat_map(|k| [k, -k]) {
        let predicted_x = CROSSING.x - range * turn * f64::from(order);
        // Nearer to this one than to its neighbours.
        let reach = 0.4 * range * turn;
        if predicted_x - 0.15 < grid.x.first || predicted_x + 0.15 > grid.x.last() {
            continue;
        }
        let near = (0..image.len())
            .filter(|voxel| (grid.x.position(voxel % grid.x.count) - predicted_x).abs() <= reach)
            .max_by(|a, b| image[*a].total_cmp(&image[*b]));
        let Some(voxel) = near else { continue };
        found.push(Ghost {
            order,
            predicted_x,
            measured_x: grid.x.position(voxel % grid.x.count),
            predicted_db: -20.0 * (f64::from(order.abs()) * smear).max(1.0).log10(),
            measured_db: 20.0 * (f64::from(image[voxel]) / peak).log10(),
        });
    }
    Ok(found)
}

/// How far from a line a pixel must be to count as off it, m: some of the lines' own width.
const OFF: f64 = 0.25;

/// Greatest amplitude off the lines against the root mean square on them, dB.
fn off_lines_db(image: &[f32]) -> Result<f64> {
    let (grid, lines) = (super::scene::grid(), reflectors()?);
    let (mut on, mut off) = (0.0f64, 0.0f64);
    for (pixel, value) in image.iter().enumerate() {
        let p = grid.position(pixel % grid.x.count, 0, pixel / grid.x.count);
        let distance = lines.positions().iter().map(|r| r.distance(p)).fold(f64::INFINITY, f64::min);
        if distance == 0.0 {
            on += f64::from(*value).powi(2);
        } else if distance > OFF {
            off = off.max(f64::from(*value));
        }
    }
    Ok(20.0 * (off / (on / lines.len() as f64).sqrt()).log10())
}
