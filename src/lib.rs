//! holosonar images 3-D scenes with sound: a loudspeaker at the origin, a planar microphone array, stepped frequencies, and
//! a reconstruction that turns the recorded interference into a volume and a depth map.
//!
//! It extends the method of Streeter et al. \[1\], a 2-D demonstration, to 3-D:
//!
//! ```text
//! mesh (OBJ, glTF, STL, PLY) -> reflectors A(p) -> data cube m(f, r) -> volume Â(p) -> depth map -> EXR, VTI, npz, PNG
//!                     ^ BVH occlusion    ^ Eq. 5              ^ Eq. 13 = 16
//! ```
//!
//! A *measured* cube enters in the middle, at m(f, r), exactly like a simulated one.
//!
//! # Example
//! One reflector, recorded by 11 × 11 microphones, is reconstructed at its position with amplitude 1:
//! ```
//! use holosonar::glam::DVec3;
//! use holosonar::acquisition::{Instrument, MicArray, SimulateOptions, Sweep, simulate};
//! use holosonar::grid::{Axis, Grid};
//! use holosonar::reconstruct::{ReconstructOptions, reconstruct};
//! use holosonar::reflectors::Reflectors;
//! use holosonar::num_complex::Complex32;
//!
//! let p = DVec3::new(0.03, -0.06, 0.8);
//! let reflector = Reflectors::new(vec![p], vec![Complex32::ONE])?;
//! let sweep = Sweep::stepped(10e3, 14e3, 100.0)?;
//! let array = MicArray::rectangular([11, 11], [0.03, 0.03], DVec3::ZERO)?;
//! let instrument = Instrument::new(sweep, array);
//! let cube = simulate(&reflector, &instrument, &SimulateOptions::default())?;
//!
//! let lateral = Axis { first: -0.15, pitch: 0.03, count: 11 };
//! let grid = Grid { x: lateral, y: lateral, z: Axis { first: 0.7, pitch: 0.02, count: 11 } };
//! let volume = reconstruct(&cube, &grid, &ReconstructOptions::default())?.volume;
//! assert!((volume.plane(5)[3 * 11 + 6].norm() - 1.0).abs() < 0.01);
//! # Ok::<(), holosonar::error::Error>(())
//! ```
//!
//! # Guide
//! How to use it: the [run file](guide::run_file), the [files](guide::files), [measured data](guide::measured), from
//! [Python](guide::python), and how to [design](guide::design) a measurement. What it does: the
//! [physics](guide::physics), the [method](guide::method), the [metrics](guide::metrics), the [paper](guide::paper)
//! reproduced. What to expect: [interruption](guide::interruption) and
//! memory, [performance](guide::performance), [limits](guide::limits). Where things are: the [code](guide::code).
//!
//! # Conventions
//! - SI units: m, s, Hz, m/s. Angles in run files are degrees. Phases are counted in cycles.
//! - Axes as in computer vision: right-handed, x right, y **down**, +z from the array into the scene, as seen from behind
//!   the array. The array is in the plane z = 0, the speaker at the origin. So an image's column is x and its row is y, in
//!   every EXR, PNG and slice, without any flip.
//! - Arrays are `[frequency, y, x]` (cubes), `[z, y, x]` (volumes), `[y, x]` (maps), x fastest.
//! - *Path length* is `|p − s| + |p − r|`, or `2|p − r|` for a monostatic scan; *range* is `|p|`; *depth* is `p_z`.
//! - Quadrature: `m = Σ A e^{+i2πf·path/c}`. In-phase: its real part.
//! - Reconstruction: `Â(p) = w/(Σw_f Σw_r) Σ_f Σ_r w_f w_r m(f, r) e^{−i2πf·path/c}`, w = 1 in quadrature and 2 in
//!   phase, so one unit reflector on a voxel peaks at 1.
//! - Geometry is f64; a phase is wrapped before it becomes f32.
//!
//! # Symbols
//! | symbol | meaning | unit | where |
//! |---|---|---|---|
//! | p, r, s | voxel or reflector, microphone, speaker | m | [`wave`] |
//! | A(p), Â(p) | amplitude, and its reconstruction | – | [`reflectors`], [`reconstruct`] |
//! | m(f, r) | data cube | – | [`acquisition`] |
//! | f₀, B, δf, n_f | first frequency, bandwidth, step, count | Hz | [`acquisition::Sweep`] |
//! | c, λ_c, λ_min | sound speed; wavelength at the band's centre, and the shortest | m/s, m | [`plan`] |
//! | Δd = c/2B | range resolution (Eq. 10) | m | [`acquisition::Instrument::range_resolution`] |
//! | D | extent of the array | m | [`acquisition::MicArray::extent`] |
//! | λ_c z/D | lateral resolution (not Eq. 12, which is an angle) | m | [`acquisition::Instrument::lateral_resolution`] |
//!
//! # Invariants
//! - A module imports only from modules above it in the list below; a test reads the sources and checks it.
//! - [`reconstruct`] and [`depth`] never see the scene, so they cannot know the answer.
//! - Only [`pipeline`] and the command line see the run file; stages take their own parameters and do no I/O.
//! - Only the command line prints, draws progress or exits.
//! - The only settings of the whole process change no byte of a result: the limit on vector instructions
//!   ([`wave::simd::limit`]), and in the command line the record of its files, by which it refuses to overwrite an input.
//! - Stages run on the threads of rayon's current pool (`ThreadPool::install`), and within the memory limit of their options.
//! - For every fast path there is a literal one, and a test compares them.
//! - With the same inputs and seed, results are bit-identical for any number of threads, memory limit or interruption. Our
//!   own loops are bit-identical for any vector width too ([`wave::simd::limit`]); matrix products and the C library's sines
//!   may round differently on another processor, by at most 2·10⁻⁶ of the maximum amplitude.
//! - What a user can cause is an [`error::Error`]; a panic is our mistake.
//! - `unsafe` is in [`wave::simd`], which also says why that is not in `reconstruct`.
//!
//! \[1\] L. Streeter, J. Scott, C. A. Lickfold, M. J. Cree, "Design of a Pseudo-Holographic Distributed Time-of-Flight
//! Sonar Range-Imaging System". Equation numbers in these pages are that paper's.

// Items that only the command line uses are unused in a library without it.
#![cfg_attr(not(feature = "cli"), allow(dead_code, unused_imports))]

pub use glam;
pub use num_complex;

mod text;
pub mod error;
mod choice;
mod with_fields;
mod alloc;
pub mod progress;
mod blocks;
mod files;
pub mod wave;
mod linalg;
pub mod grid;
pub mod scene;
pub mod reflectors;
pub mod acquisition;
pub mod reconstruct;
pub mod depth;
pub mod truth;
pub mod metrics;
pub mod plan;
pub mod psf;
pub mod focus;
pub mod export;
pub mod checkpoint;
pub mod config;
pub mod pipeline;
pub mod guide;
#[cfg(feature = "cli")]
#[doc(hidden)] // not an interface: the binary calls its `main`
pub mod cli;
#[cfg(feature = "python")]
mod python;

// Assertions on messages, shared by unit tests and integration tests.
#[cfg(test)]
#[path = "../tests/holosonar/named.rs"]
mod named;
