//! Figure 7: the effect of too few microphones, and the rule that predicts it.
//!
//! Microphones with the pitch d do not distinguish the directions sin θ and sin θ − kλ/d, so that an echo at p has grating
//! lobes at `x_k = |p|·(p̂_x − kλ/d)`, λ at the middle of the band, according to classical theory. The paper looked for
//! `(2^N − 1)/x = 7.5 m`, which is the number of microphones *per metre*: a sampling frequency, not a distance.

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

/// A grating lobe of a point, predicted and measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct LobeComparison {
    /// Its direction from the point, in multiples of λ/d.
    pub(super) order: i32,
    /// Position by the rule, m.
    pub(super) predicted_x: f64,
    /// Position of the image's maximum near there, m.
    pub(super) measured_x: f64,
    /// Approximate level relative to the point, `−20 log₁₀ max(1, |k|(N−1)B/f_c)`, dB.
    pub(super) predicted_db: f64,
    /// Measured level relative to the point, dB.
    pub(super) measured_db: f64,
}

/// The images of the scene and of a point where its lines cross, for a number of microphones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct AliasingStudy {
    /// Microphones over 2 m.
    pub(super) microphones: usize,
    /// λ/d: the distance between grating lobes, in sin θ.
    pub(super) turn: f64,
    /// λ|p|/d: the same at the crossing, m.
    pub(super) spacing: f64,
    /// Grating lobes of a point at the crossing, nearest first.
    #[serde(rename = "ghosts")]
    pub(super) lobes: Vec<LobeComparison>,
    /// Maximum amplitude away from the lines of the scene, relative to the root mean square on them, dB.
    pub(super) off_lines_db: f64,
    /// The scene's image, `[z, x]`, with a maximum of 1.
    #[serde(skip)]
    pub(super) image: Vec<f32>,
}

/// Microphones in the figure's panels, and in the full row.
const COUNTS: [usize; 4] = [15, 31, 63, 255];

/// Level above which grating lobes are visible next to the lines, dB: parts of the lines themselves are at about −13 dB.
const VISIBLE_DB: f64 = -6.0;

/// Maximum order of grating lobes: those of higher order are far away and weak.
const MAX_ORDER: i32 = 2;

impl AliasingStudy {
    /// Whether grating lobes are visible in the picture of the scene.
    pub(super) fn shows_lobes(&self) -> bool {
        self.off_lines_db > VISIBLE_DB
    }
}

/// Images the scene and a point with few microphones.
pub(super) fn study(observer: &dyn Observer) -> Result<Vec<AliasingStudy>> {
    stage(observer, "aliasing", COUNTS.len() as u64, || {
        let of = |microphones: usize| {
            let aliasing = one(&Case { microphones, ..CASES[2] })?;
            advance(observer, 1).map(|()| aliasing)
        };
        COUNTS.into_iter().map(of).collect()
    })
}

fn one(case: &Case) -> Result<AliasingStudy> {
    let (image, _) = nonlinear(&cube(case, Exact)?)?;
    let wavelength = DEFAULT_SOUND_SPEED / (20_000.0 - case.bandwidth / 2.0);
    let turn = wavelength / pitch(case);
    Ok(AliasingStudy {
        microphones: case.microphones,
        turn,
        spacing: turn * CROSSING.length(),
        lobes: lobes(case, turn)?,
        off_lines_db: off_lines_db(&image)?,
        image,
    })
}

/// The grid for the grating lobes of a point: wider than the picture, and ± 15 cm in depth, since they are curved.
fn search_grid() -> Grid {
    let axis = |first: f64, pitch: f64, count: usize| Axis { first, pitch, count };
    Grid { x: axis(-1.4, 0.005, 661), y: axis(0.0, 1.0, 1), z: axis(3.0, 0.01, 31) }
}

fn lobes(case: &Case, turn: f64) -> Result<Vec<LobeComparison>> {
    let point = Reflectors::new(vec![CROSSING], vec![Complex32::ONE])?;
    let (grid, options) = (search_grid(), ReconstructOptions::new(Method::Auto, Window::None));
    let cube = cube_of(&point, case, Exact)?;
    let volume = reconstruct(&cube, &grid, &options)?.volume;
    let (image, peak) = (amplitudes(&volume.samples), f64::from(volume.peak()));
    let (range, smear) =
        (CROSSING.length(), (case.microphones - 1) as f64 * case.bandwidth / cube.instrument.sweep.centre());
    let mut found = Vec::new();
    for order in (1..=MAX_ORDER).flat_map(|k| [k, -k]) {
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
        found.push(LobeComparison {
            order,
            predicted_x,
            measured_x: grid.x.position(voxel % grid.x.count),
            predicted_db: -20.0 * (f64::from(order.abs()) * smear).max(1.0).log10(),
            measured_db: 20.0 * (f64::from(image[voxel]) / peak).log10(),
        });
    }
    Ok(found)
}

/// Minimum distance of a pixel off the lines, m: several times the width of a line.
const OFF: f64 = 0.25;

/// Maximum amplitude off the lines, relative to the root mean square on them, dB.
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
