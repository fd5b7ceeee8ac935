//! Samples surfaces into reflectors: a cloud of points p with complex amplitudes A(p), the only input of the wave model.
//!
//! A scene's triangles are sampled ([`sample_surface`]) and shaded, and what the speaker does not reach is dropped;
//! or a list of points is read as it is ([`Reflectors::read_csv`]). Dense coherent samples of a flat surface act as
//! a mirror, so the default surface is diffuse: every reflector has its own random phase.
//!
//! # Example
//! A plate of 0.1 m² facing the array, sampled every 2 cm; the energy does not depend on the spacing:
//! ```
//! use holosonar::glam::DVec3;
//! use holosonar::reflectors::{SurfaceOptions, sample_surface};
//! use holosonar::scene::{Material, Scene, Triangle};
//!
//! let corner = |x, y| DVec3::new(x, y, 1.0);
//! let half = |a, b| Triangle { vertices: [corner(-0.25, -0.1), a, b], material: 0 };
//! let far = corner(0.25, 0.1);
//! let plate = vec![half(corner(0.25, -0.1), far), half(far, corner(-0.25, 0.1))];
//! let wall = Material { name: "wall".into(), reflectance: 1.0, transmittance: 0.0, source: "here".into() };
//! let scene = Scene::new(plate, vec![wall])?;
//! let energy = |spacing| -> holosonar::error::Result<f32> {
//!     let cloud = sample_surface(&scene, &SurfaceOptions::new(spacing, 0.0229))?;
//!     Ok(cloud.amplitudes().iter().map(|a| a.norm_sqr()).sum())
//! };
//! let (coarse, fine) = (energy(0.02)?, energy(0.01)?);
//! assert!((coarse / fine - 1.0).abs() < 0.02, "{coarse} {fine}");
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod bounced;
mod bounces;
pub(crate) mod csv;
mod edges;
mod facets;
mod lattice;
mod moving;
mod occlusion;
mod poisson;
mod pricing;
#[cfg(test)]
mod tests;

use crate::alloc::{try_filled, try_with_capacity};
use crate::error::{Error, Result};
use crate::progress::{Observer, Silent, advance, stage};
use crate::scene::{FARTHEST, Scene};
use crate::wave::{bounding_box, phasor};
use crate::with_fields::with_fields;
pub use bounced::BounceCounts;
use bounced::Bounced;
pub(crate) use bounced::Detours;
pub(crate) use bounces::most_bounced;
pub use bounces::{BounceOptions, BouncePath};
use csv::LARGEST;
pub use edges::EdgeOptions;
pub(crate) use edges::most_pieces;
use glam::DVec3;
use num_complex::Complex32;
pub use occlusion::{Occlusion, OcclusionKind};
pub use pricing::TracingForecast;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rayon::prelude::*;
use std::ops::Range;

/// Point reflectors: positions in m, complex amplitudes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reflectors {
    positions: Vec<DVec3>,
    amplitudes: Vec<Complex32>,
    /// The last of them may be reached by a detour.
    bounced: Option<Bounced>,
    /// Of each, m/s; empty where nothing moves.
    velocities: Vec<DVec3>,
}

impl Reflectors {
    /// Reflectors of given positions and amplitudes.
    ///
    /// # Errors
    /// Positions (m) or amplitudes that are not finite or beyond 10⁹.
    ///
    /// # Panics
    /// When there are not as many amplitudes as positions.
    pub fn new(positions: Vec<DVec3>, amplitudes: Vec<Complex32>) -> Result<Self> {
        assert_eq!(positions.len(), amplitudes.len(), "one amplitude per position");
        let valid = |(p, a): (&DVec3, &Complex32)| {
            p.abs().max_element() <= FARTHEST && !p.is_nan() && f64::from(a.norm()) <= LARGEST
        };
        if let Some(bad) = positions.iter().zip(&amplitudes).position(|pair| !valid(pair)) {
            let problem = format!(
                "is at {} m with amplitude {}; finite numbers were expected, positions up to {FARTHEST:e} m and amplitudes \
                 up to {LARGEST:e} (1 reflects all)",
                positions[bad], amplitudes[bad]
            );
            return Err(Error::input(format!("reflector {bad}"), problem));
        }
        Ok(Self { positions, amplitudes, bounced: None, velocities: Vec::new() })
    }

    /// Positions p, m.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Amplitudes A(p).
    pub fn amplitudes(&self) -> &[Complex32] {
        &self.amplitudes
    }

    /// Number of reflectors.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is nothing to reflect.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Minimum and maximum coordinates, m; `None` without reflectors.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        bounding_box(self.positions.iter().copied())
    }
}

/// How a surface scatters sound. The guide's chapter `guide::physics` compares the models.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SurfaceModel {
    /// A seeded random phase per reflector.
    Diffuse,
    /// Reflectors displaced along the normal by a Gaussian of this rms, m; amplitudes stay real.
    Rough(f64),
    /// A mirror: samples on a lattice, in phase, undisplaced. Needs a spacing of at most a quarter of the shortest
    /// wavelength, otherwise the lattice itself scatters.
    Smooth,
}

/// Parameters of [`sample_surface`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SurfaceOptions {
    /// Minimum distance between neighbouring reflectors, m (the lattice's pitch for a smooth surface).
    pub spacing: f64,
    /// Wavelength at the centre of the band, m: sets the reference area `A_c = (λ_c/2)²`.
    pub wavelength: f64,
    /// How surfaces scatter.
    pub surface: SurfaceModel,
    /// Whether amplitude falls with `|cos|` of the incidence angle at the speaker.
    pub lambert: bool,
    /// What hides a reflector.
    pub occlusion: Occlusion,
    /// Where the sound comes from, m.
    pub speaker: DVec3,
    /// Seed of positions, phases and roughness.
    pub seed: u64,
    /// Echoes of several surfaces; `None` for those of one alone, whose amplitudes have another scale.
    pub bounces: Option<BounceOptions>,
    /// Echoes of edges, if any.
    pub edges: Option<EdgeOptions>,
    /// Velocities of some of the triangles, m/s, by their numbers; what is in none of the ranges is still.
    pub velocities: Vec<(Range<usize>, DVec3)>,
}

with_fields! {
    SurfaceOptions {
        with_surface(surface: SurfaceModel),
        with_lambert(lambert: bool),
        with_occlusion(occlusion: Occlusion),
        with_speaker(speaker: DVec3),
        with_seed(seed: u64),
        with_bounces(bounces: Option<BounceOptions>),
        with_edges(edges: Option<EdgeOptions>),
        with_velocities(velocities: Vec<(Range<usize>, DVec3)>),
    }
}

impl SurfaceOptions {
    /// Diffuse, shaded and occluded reflectors every `spacing` m for a centre wavelength in m, speaker at the origin.
    pub fn new(spacing: f64, wavelength: f64) -> Self {
        Self {
            spacing,
            wavelength,
            surface: SurfaceModel::Diffuse,
            lambert: true,
            occlusion: Occlusion::Speaker,
            speaker: DVec3::ZERO,
            seed: 1,
            bounces: None,
            edges: None,
            velocities: Vec::new(),
        }
    }
}

/// A point of a surface and the area it represents.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sample {
    position: DVec3,
    triangle: u32,
    /// m²; all areas add up to the scene's.
    area: f64,
}

/// Streams of the seed, one per purpose, so that changing one draw leaves the others unchanged.
const SCATTER_STREAM: u64 = 1;

/// Peak memory of [`sample_surface`], bytes, in addition to a scene of this many triangles and this area, m², so that a
/// job that cannot fit is refused before it begins.
pub(crate) fn sampling_bytes(triangles: u64, area: f64, options: &SurfaceOptions) -> u64 {
    match options.surface {
        SurfaceModel::Smooth => {
            (area / (options.spacing * options.spacing)) as u64 * 2 * size_of::<Sample>() as u64
        }
        _ => poisson::bytes(triangles, area, options.spacing),
    }
}

/// Samples the surfaces of a scene and includes shading and occlusion in the amplitudes.
///
/// `A = ρ · |cos θ| · √(a·A_c) · T` with reflectance ρ, incidence angle θ at the speaker, area a of the sample,
/// `A_c = (λ_c/2)²` and T the transmittance of what the path crosses, there and back. `√(a·A_c)` makes the
/// brightness independent of the sampling density: echoes of random phase add in power, and the areas a add up to that
/// of the surface. Reflectors without amplitude, and those behind the array (z ≤ 0), are left out.
///
/// - Cost: about 16 candidates and one ray (ten with `Aperture`) per reflector.
/// - Results are bit-identical for the same options, whatever the number of threads.
///
/// # Errors
/// A spacing that is not positive or would need more than 5·10⁷ reflectors; [`Error::OutOfMemory`] when they do not fit in
/// memory.
pub fn sample_surface(scene: &Scene, options: &SurfaceOptions) -> Result<Reflectors> {
    sample_surface_with(scene, options, &Silent)
}

/// [`sample_surface`], reporting its progress to `observer`, which may stop it.
///
/// # Errors
/// As [`sample_surface`]; `Error::Interrupted` when the observer asks to stop.
pub fn sample_surface_with(
    scene: &Scene,
    options: &SurfaceOptions,
    observer: &dyn Observer,
) -> Result<Reflectors> {
    if !(options.spacing.is_finite() && options.spacing > 0.0) {
        return Err(Error::input("reflectors.spacing", "must be a positive length in metres"));
    }
    let expected = scene.surface_area() / (options.spacing * options.spacing);
    if expected > 5e7 {
        return Err(Error::input(
            "reflectors.spacing",
            format!(
                "{} m over {:.3} m² of surface would need about {expected:.1e} reflectors; use a larger spacing, \
                 and check the scene's unit and scale",
                options.spacing,
                scene.surface_area()
            ),
        ));
    }
    let samples = match options.surface {
        SurfaceModel::Smooth => stage(observer, "sampling surfaces", 0, || {
            lattice::lattice(scene.triangles(), options.spacing).ok_or_else(|| does_not_fit(options.spacing))
        }),
        _ => {
            stage(observer, "sampling surfaces", poisson::work(scene.surface_area(), options.spacing), || {
                poisson::poisson_disk(scene.triangles(), options.spacing, options.seed, observer)
            })
        }
    }?;
    let does_not_fit = || does_not_fit(options.spacing);
    let scatter = draw_scatter(samples.len(), options).ok_or_else(does_not_fit)?;
    warn_of_those_behind(&samples, observer);
    let list = match &options.bounces {
        Some(bounces) => bounces::reflect(scene, options, bounces, &samples, &scatter, observer)?,
        None => reflect_once(scene, options, &samples, &scatter, observer)?,
    };
    match &options.edges {
        Some(edges) => edges::append(list, scene, options, edges, observer),
        None => Ok(list),
    }
}

/// The reflectors of a scene's samples that sound reaches directly.
fn reflect_once(
    scene: &Scene,
    options: &SurfaceOptions,
    samples: &[Sample],
    scatter: &[(Complex32, f64)],
    observer: &dyn Observer,
) -> Result<Reflectors> {
    let does_not_fit = || does_not_fit(options.spacing);
    let mut visible: Vec<Option<(DVec3, Complex32)>> =
        try_filled(None, samples.len() as u64).ok_or_else(does_not_fit)?;
    stage(observer, "tracing echoes", samples.len() as u64, || {
        let blocks = samples.par_chunks(1024).zip(scatter.par_chunks(1024)).zip(visible.par_chunks_mut(1024));
        blocks.try_for_each(|((samples, scatter), visible)| {
            for ((sample, scatter), visible) in samples.iter().zip(scatter).zip(visible) {
                *visible = reflect(scene, options, sample, *scatter);
            }
            advance(observer, samples.len() as u64)
        })
    })?;
    let left = visible.iter().flatten().count() as u64;
    let mut positions = try_with_capacity(left).ok_or_else(does_not_fit)?;
    let mut amplitudes = try_with_capacity(left).ok_or_else(does_not_fit)?;
    let moves = !options.velocities.is_empty();
    let mut velocities = try_with_capacity(if moves { left } else { 0 }).ok_or_else(does_not_fit)?;
    for (sample, (position, amplitude)) in
        samples.iter().zip(visible).filter_map(|(sample, visible)| Some((sample, visible?)))
    {
        positions.push(position);
        amplitudes.push(amplitude);
        if moves {
            velocities.push(options.velocity_of(sample.triangle as usize));
        }
    }
    Reflectors::new(positions, amplitudes)?.with_velocities(velocities)
}

/// Warns of samples behind the array.
fn warn_of_those_behind(samples: &[Sample], observer: &dyn Observer) {
    let behind = samples.iter().filter(|s| s.position.z <= 0.0).count();
    if behind > 0 {
        observer.warn(&format!(
            "{behind} of {} reflectors are behind the array (z <= 0) and are ignored; move the scene with \
                 [scene] translate or fit if this is not intended",
            samples.len()
        ));
    }
}

/// The error for a surface whose samples do not fit in memory.
fn does_not_fit(spacing: f64) -> Error {
    Error::out_of_memory(format!(
        "the reflectors of a scene sampled every {spacing} m do not fit in memory; use a larger [reflectors] spacing, \
             or free some memory"
    ))
}

/// The random phase factor and displacement, m, of each sample, drawn before anything is culled. `None` when they do
/// not fit in memory.
fn draw_scatter(count: usize, options: &SurfaceOptions) -> Option<Vec<(Complex32, f64)>> {
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    random.set_stream(SCATTER_STREAM);
    let mut scatter = try_with_capacity(count as u64)?;
    // What a rough wall scatters beside its mirror image has a random phase, too; displaced samples in phase would be a mirror
    // again.
    let surface = if options.bounces.is_some() { SurfaceModel::Diffuse } else { options.surface };
    scatter.extend((0..count).map(|_| match surface {
        SurfaceModel::Diffuse => {
            let cycles: f64 = StandardUniform.sample(&mut random);
            (phasor(cycles), 0.0)
        }
        SurfaceModel::Rough(rms) => {
            let g: f64 = StandardNormal.sample(&mut random);
            (Complex32::ONE, g * rms)
        }
        SurfaceModel::Smooth => (Complex32::ONE, 0.0),
    }));
    Some(scatter)
}

/// The reflector of one sample; `None` where nothing is reflected.
fn reflect(
    scene: &Scene,
    options: &SurfaceOptions,
    sample: &Sample,
    (phase, displacement): (Complex32, f64),
) -> Option<(DVec3, Complex32)> {
    let triangle = &scene.triangles()[sample.triangle as usize];
    let material = &scene.materials()[triangle.material as usize];
    let (p, normal) = (sample.position, triangle.normal());
    if p.z <= 0.0 {
        return None;
    }
    let cosine =
        if options.lambert { normal.dot((options.speaker - p).normalize_or_zero()).abs() } else { 1.0 };
    // Surfaces are thin compared with the spacing of rays: occlusion is decided where the surface is, not where
    // roughness has displaced the reflector.
    let transmittance = options.occlusion.there_and_back(scene, options.speaker, p);
    let reference_area = (options.wavelength / 2.0).powi(2);
    let amplitude = material.reflectance * cosine * (sample.area * reference_area).sqrt() * transmittance;
    (amplitude > 0.0).then(|| (p + normal * displacement, phase * amplitude as f32))
}
