//! From what was typed to the parameters of the stages; the only place where one becomes the other.

use super::check::square_root;
use super::{Layout, RunFile, Shading, Surface};
use crate::acquisition::{ArrayErrors, Instrument, Losses, MicArray, Noise, SimulateOptions, Sweep};
use crate::depth::DepthOptions;
use crate::error::{Error, Result};
use crate::grid::{Axis, Grid, Raster, View};
use crate::plan::memory_limit;
use crate::reconstruct::ReconstructOptions;
use crate::reflectors::{Occlusion, OcclusionKind, SurfaceModel, SurfaceOptions};
use crate::scene::{CameraView, LoadOptions};
use crate::truth::TruthOptions;
use crate::wave::{Geometry, GeometryKind};
use glam::DVec3;

/// A bare scene is put this many diagonals of its box away.
const FIT_BY_DIAGONAL: f64 = 2.0;

/// Rows of a perspective view whose pixels nobody said.
const ROWS: f64 = 256.0;

/// Margin of a grid that follows from the scene, as a share of the scene's size to each side.
const MARGIN: f64 = 0.05;

impl RunFile {
    /// `[sweep]`.
    ///
    /// # Errors
    /// A band that is no multiple of the step, and other sweeps that are none.
    pub fn sweep(&self) -> Result<Sweep> {
        Sweep::stepped(self.sweep.start, self.sweep.stop, self.sweep.step)
            .map_err(|error| error.at("[sweep]"))
    }

    /// `[array]`: the microphones.
    ///
    /// # Errors
    /// Counts or pitches that make no array; a missing or malformed file of positions.
    pub fn microphones(&self) -> Result<MicArray> {
        let array = &self.array;
        let centre = DVec3::from_array(array.centre);
        if let (Layout::File, Some(file)) = (array.layout, &array.file) {
            return MicArray::read(&file.path);
        }
        // As many microphones over the same extent, whatever the layout.
        let sides = match (array.count, array.elements) {
            (Some(count), _) => count.map(f64::from),
            (None, elements) => [f64::from(elements.unwrap_or(1)).sqrt(); 2],
        };
        let count = array.count.map(|count| count.map(|n| n as usize));
        let elements = count.map_or(array.elements.unwrap_or(1) as usize, |[x, y]| x.saturating_mul(y));
        let extent: [f64; 2] = std::array::from_fn(|axis| match (array.extent, array.pitch) {
            (Some(extent), _) => extent[axis],
            (None, pitch) => pitch.map_or(f64::NAN, |pitch| pitch[axis]) * (sides[axis] - 1.0),
        });
        let microphones = match array.layout {
            Layout::Spiral => MicArray::spiral(elements, extent, centre),
            Layout::Random => {
                let seed = array.seed.unwrap_or(1).into();
                MicArray::random(elements, extent, centre, array.spacing, seed)
            }
            Layout::Grid | Layout::File => {
                let side = array.elements.and_then(square_root).unwrap_or(1) as usize;
                let count = count.unwrap_or([side; 2]);
                let pitch = |axis: usize| match (array.pitch, array.extent) {
                    (_, Some(extent)) => extent[axis] / count[axis].saturating_sub(1).max(1) as f64,
                    (pitch, None) => pitch.map_or(f64::NAN, |p| p[axis]),
                };
                MicArray::rectangular(count, [pitch(0), pitch(1)], centre)
            }
        };
        microphones.map_err(|error| error.at("[array]"))
    }

    /// `[array] geometry` and `source`.
    pub fn geometry(&self) -> Geometry {
        match self.array.geometry {
            GeometryKind::FixedSource => {
                Geometry::FixedSource { source: DVec3::from_array(self.array.source) }
            }
            GeometryKind::Monostatic => Geometry::Monostatic,
        }
    }

    /// `[sweep]`, `[array]`, `[detection] kind` and the speed of sound of `[medium]`.
    ///
    /// # Errors
    /// As [`RunFile::sweep`] and [`RunFile::microphones`].
    pub fn instrument(&self) -> Result<Instrument> {
        let instrument = Instrument::new(self.sweep()?, self.microphones()?);
        Ok(instrument
            .with_geometry(self.geometry())
            .with_detection(self.detection.kind)
            .with_sound_speed(self.medium.speed()))
    }

    /// `[scene]` and `[[materials]]`. With neither `fit` nor `translate` the mesh stays where it is, unless `bare`:
    /// then its centre goes to z = 2 diagonals of its box.
    ///
    /// # Errors
    /// A sensor that is neither `camera:NAME` nor `node:NAME`.
    pub fn load_options(&self, bare: bool) -> Result<LoadOptions> {
        let typed = &self.scene;
        let mut options = LoadOptions::default();
        (options.unit, options.up, options.scale) = (typed.unit, typed.up, typed.scale);
        options.rotate = DVec3::from_array(typed.rotate);
        options.translate = typed.translate.map_or(DVec3::ZERO, DVec3::from_array);
        options.fit = typed.fit.map(DVec3::from_array);
        let placed = typed.fit.is_some() || typed.translate.is_some() || typed.sensor.is_some();
        options.fit_by_diagonal = (bare && !placed).then_some(FIT_BY_DIAGONAL);
        options.sensor = typed.sensor.as_deref().map(str::parse).transpose()?;
        options.materials.clone_from(&self.materials);
        options.memory = memory_limit(self.memory);
        Ok(options)
    }

    /// `[reflectors]` and `[scene] occlusion`, for a scene whose nearest surface lies at `nearest_z` m.
    pub fn surface_options(&self, instrument: &Instrument, nearest_z: f64) -> SurfaceOptions {
        let typed = &self.reflectors;
        let mirror = typed.surface == Surface::Smooth;
        let spacing = typed.spacing.unwrap_or_else(|| instrument.advised_spacing(nearest_z.max(0.0), mirror));
        let mut options = SurfaceOptions::new(spacing, instrument.wavelength());
        options.surface = match typed.surface {
            Surface::Diffuse => SurfaceModel::Diffuse,
            Surface::Rough => SurfaceModel::Rough(typed.roughness * instrument.wavelength()),
            Surface::Smooth => SurfaceModel::Smooth,
        };
        options.lambert = typed.shading == Shading::Lambert;
        options.occlusion = match self.scene.occlusion {
            OcclusionKind::None => Occlusion::None,
            OcclusionKind::Speaker => Occlusion::Speaker,
            OcclusionKind::Aperture => Occlusion::Aperture(instrument.array.sight_points().to_vec()),
        };
        options.speaker = instrument.geometry.viewpoint(instrument.array.centre());
        options.seed = typed.seed.into();
        options
    }

    /// What the truth is traced with: as the reflectors were heard.
    pub fn truth_options(&self, instrument: &Instrument) -> TruthOptions {
        let mut options = TruthOptions::for_speaker(instrument.geometry.viewpoint(instrument.array.centre()));
        options.lambert = self.reflectors.shading == Shading::Lambert;
        if self.scene.occlusion == OcclusionKind::None {
            options.speaker = None;
        }
        options
    }

    /// `[detection]`, `[medium]` and `[array]` for the simulation.
    pub fn simulate_options(&self) -> SimulateOptions {
        // The noise has a stream of its own, so that it does not follow the surfaces' phases.
        let seed = u64::from(self.reflectors.seed) ^ 0x006e_6f69_7365_0000;
        let array = &self.array;
        let errors = ArrayErrors {
            gain_db: array.gain_error_db,
            phase: array.phase_error,
            position: array.position_error,
            seed: u64::from(array.error_seed) ^ 0x6172_7261_7900_0000,
        };
        SimulateOptions {
            model: self.detection.model,
            losses: Losses {
                spreading: self.medium.spreading,
                air: self.medium.air().filter(|_| self.medium.absorption),
                speaker_radius: array.speaker_radius,
                microphone_radius: array.microphone_radius,
            },
            errors: (errors.gain_db > 0.0 || errors.phase > 0.0 || errors.position > 0.0).then_some(errors),
            noise: self.detection.snr_db.map(|snr_db| Noise { snr_db, seed }),
            tolerance: self.detection.tolerance,
        }
    }

    /// `[grid]`; what is left out follows from the scene's box and the plan's advice.
    ///
    /// # Errors
    /// Axes that are none, or a grid that is left out although there is no scene to take it from.
    pub fn voxels(&self, instrument: &Instrument, scene: Option<(DVec3, DVec3)>) -> Result<Grid> {
        let typed = &self.grid;
        let margin = |low: f64, high: f64| {
            let margin = ((high - low) * MARGIN).max(2.0 * instrument.wavelength());
            [low - margin, high + margin]
        };
        let from_scene = |axis: usize| {
            let (low, high) = scene.ok_or_else(|| {
                Error::input(
                    "[grid]",
                    format!(
                        "is missing or incomplete, and without a scene there is nothing to take it from; give a run file \
                         (-c) with x, y and z as [first, last] in metres, for example\n\n{}",
                        instrument.suggested_grid_table()
                    ),
                )
            })?;
            Ok(margin(low[axis], high[axis]))
        };
        let x = typed.x.map_or_else(|| from_scene(0), Ok)?;
        let y = typed.y.map_or_else(|| from_scene(1), Ok)?;
        let z = if let Some(z) = typed.z {
            z
        } else {
            // Nothing behind the array can be imaged.
            let [first, last] = from_scene(2)?;
            let first = first.max(instrument.wavelength());
            if last < first {
                return Err(Error::input(
                    "[scene]",
                    format!(
                        "lies behind the array or in it (z up to {:.3} m), so no grid can follow from it; move it with \
                         `translate` or `fit`, or give [grid]",
                        scene.map_or(f64::NAN, |(_, high)| high.z)
                    ),
                ));
            }
            [first, last]
        };
        let advised = instrument.advised_pitch(z[0].max(instrument.wavelength()));
        let pitch = typed.pitch.unwrap_or(advised);
        let axis = |name: &str, ends: [f64; 2], pitch: f64| -> Result<Axis> {
            Axis::spanning(ends[0], ends[1], pitch).map_err(|error| error.at(format!("[grid] {name}")))
        };
        Ok(Grid { x: axis("x", x, pitch[0])?, y: axis("y", y, pitch[1])?, z: axis("z", z, pitch[2])? })
    }

    /// `[reconstruct]`.
    pub fn reconstruct_options(&self) -> ReconstructOptions {
        let mut options = ReconstructOptions::new(self.reconstruct.method, self.reconstruct.window);
        options.tolerance = self.reconstruct.tolerance;
        options.compensate = self.reconstruct.compensate;
        options
    }

    /// `[depth] view`: the pixels, or `None` for those of the grid; `camera` is the one that the array was put at.
    ///
    /// # Errors
    /// A perspective view whose field of view neither the run file nor the camera says.
    pub fn raster(&self, camera: Option<CameraView>) -> Result<Option<Raster>> {
        if self.depth.view == View::Orthographic {
            return Ok(None);
        }
        let fov = self.depth.fov.or_else(|| camera.map(|camera| camera.vertical_field_of_view)).ok_or_else(|| {
            Error::input(
                "[depth] fov",
                "is missing: a perspective view needs its vertical field of view in degrees, unless the array sits at a \
                 perspective camera of a glTF scene ([scene] sensor = \"camera:NAME\")",
            )
        })?;
        let shape = camera.and_then(|camera| camera.aspect_ratio).unwrap_or(1.0);
        let advised = [(shape * ROWS).round().clamp(1.0, 64.0 * ROWS) as usize, ROWS as usize];
        let pixels = self.depth.pixels.map_or(advised, |pixels| pixels.map(|n| n as usize));
        Raster::camera(fov, pixels).map(Some).map_err(|error| error.at("[depth] fov"))
    }

    /// `[depth]`, for a range resolution in m.
    pub fn depth_options(&self, range_resolution: f64) -> DepthOptions {
        let typed = &self.depth;
        let mut options = DepthOptions::new(range_resolution);
        (options.pick, options.refine) = (typed.pick, typed.refine);
        options.threshold_db = typed.threshold_db;
        options.returns = typed.returns as usize;
        options.return_threshold_db = typed.return_threshold_db;
        options.return_gate_db = typed.return_gate_db;
        options.return_contrast_db = typed.return_contrast_db;
        options.separation = typed.separation;
        options.smoothing = typed.smoothing;
        options.median = typed.median as usize;
        options
    }
}
