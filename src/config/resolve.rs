//! From the run file to the parameters of the stages; no other place converts one to the other.

mod calibration;
mod import;
mod coding;
mod instrument;
mod motion;
mod recording;

use super::check::square_root;
use super::{ArrayLayout, RefineMethod, RefineTable, RunFile, ScenePart, Shading, SurfaceKind};
use crate::acquisition::{
    ArrayErrors, Instrument, Losses, MicArray, Noise, RANDOM_BYTES, SimulateOptions, Sweep,
};
use crate::depth::{ArraySidelobes, DepthOptions};
use crate::error::{Error, Result, gib};
use crate::grid::{Axis, Grid, Raster, View};
use crate::plan::memory_limit;
use crate::reconstruct::{Method, ReconstructOptions, RefineOptions};
use crate::reflectors::{BounceOptions, EdgeOptions, Occlusion, OcclusionKind, SurfaceModel, SurfaceOptions};
use crate::scene::{CameraView, LoadOptions, PartFile};
use crate::truth::TruthOptions;
use crate::wave::{Geometry, GeometryKind, Resolution};
use glam::DVec3;

/// Default number of rows of a perspective view.
const ROWS: f64 = 256.0;

/// Margin of a grid that follows from the scene, on each side, as a fraction of the scene's size.
const MARGIN: f64 = 0.05;

impl RunFile {
    /// `[sweep]`.
    ///
    /// # Errors
    /// A band that is not a multiple of the step, and other invalid sweeps.
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
        if let (ArrayLayout::File, Some(file)) = (array.layout, &array.file) {
            return MicArray::read_within(&file.path, memory_limit(self.memory));
        }
        // Every layout has the same number of microphones over the same extent.
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
        let each = if array.layout == ArrayLayout::Random { RANDOM_BYTES } else { size_of::<DVec3>() as u64 };
        let bytes = each.saturating_mul(elements as u64);
        if let Some(most) = memory_limit(self.memory).filter(|most| bytes > *most) {
            let problem = format!(
                "{elements} microphones take {} of memory, and {} may be used here (--memory sets another limit); give fewer",
                gib(bytes),
                gib(most)
            );
            return Err(Error::input("[array]", problem));
        }
        let microphones = match array.layout {
            ArrayLayout::Spiral => MicArray::spiral(elements, extent, centre),
            ArrayLayout::Random => {
                let seed = array.seed.unwrap_or(1).into();
                MicArray::random(elements, extent, centre, array.spacing, seed)
            }
            ArrayLayout::Grid | ArrayLayout::File => {
                let side = array.elements.and_then(square_root).unwrap_or(1) as usize;
                let count = count.unwrap_or([side; 2]);
                let pitch = |axis: usize| match (array.pitch, array.extent) {
                    // A single one is as far from the next as those along the other axis are, or 1 m: there is no next.
                    (_, Some(extent)) => match [axis, 1 - axis].into_iter().find(|axis| count[*axis] > 1) {
                        Some(axis) => extent[axis] / (count[axis] - 1) as f64,
                        None => 1.0,
                    },
                    (pitch, None) => pitch.map_or(f64::NAN, |p| p[axis]),
                };
                MicArray::rectangular(count, [pitch(0), pitch(1)], centre)
            }
        };
        microphones.map_err(|error| error.at("[array]"))
    }

    /// `[array] geometry` and its speaker, of several the first.
    pub fn geometry(&self) -> Geometry {
        let array = &self.array;
        match array.geometry {
            GeometryKind::FixedSource => {
                let first = array.sources.as_ref().and_then(|sources| sources.first());
                Geometry::FixedSource { source: DVec3::from_array(*first.unwrap_or(&array.source)) }
            }
            GeometryKind::Monostatic => Geometry::Monostatic,
            GeometryKind::Pair => {
                Geometry::Pair { offset: DVec3::from_array(array.source_offset.unwrap_or_default()) }
            }
        }
    }

    /// `[sweep]`, `[array]`, `[detection] kind` and the speed of sound of `[medium]`.
    ///
    /// # Errors
    /// As [`RunFile::sweep`] and [`RunFile::microphones`].
    pub fn instrument(&self) -> Result<Instrument> {
        let instrument = Instrument::new(self.sweep()?, self.microphones()?)
            .with_geometry(self.geometry())
            .with_detection(self.detection.kind)
            .with_sound_speed(self.medium.speed())
            .with_interface(self.medium.interface);
        if let Some(file) = &self.array.source_file {
            let sources = MicArray::read_within(&file.path, memory_limit(self.memory))?;
            return instrument
                .with_pairs(sources.positions())
                .map_err(|error| error.at("[array] source_file"));
        }
        let Some(sources) = &self.array.sources else { return Ok(instrument) };
        let sources: Vec<DVec3> = sources.iter().map(|source| DVec3::from_array(*source)).collect();
        instrument.with_sources(&sources).map_err(|error| error.at("[array] sources"))
    }

    /// `[scene]` and `[[materials]]`. With neither `fit` nor `translate` the mesh keeps its position.
    ///
    /// # Errors
    /// A sensor that is neither `camera:NAME` nor `node:NAME`.
    pub fn load_options(&self) -> Result<LoadOptions> {
        let typed = &self.scene;
        let mut options = LoadOptions::default();
        (options.unit, options.up, options.scale) = (typed.unit, typed.up, typed.scale);
        options.size = typed.size;
        options.rotate = DVec3::from_array(typed.rotate);
        options.translate = typed.translate.map_or(DVec3::ZERO, DVec3::from_array);
        options.fit = typed.fit.map(DVec3::from_array);
        options.sensor = typed.sensor.as_deref().map(str::parse).transpose()?;
        options.materials.clone_from(&self.materials);
        options.memory = memory_limit(self.memory);
        Ok(options)
    }

    /// `[[scene.parts]]`.
    pub fn part_files(&self) -> Vec<PartFile> {
        let file = |part: &ScenePart| PartFile {
            path: part.mesh.path.clone(),
            name: part.name.clone().unwrap_or_default(),
            options: LoadOptions::default()
                .with_unit(part.unit)
                .with_up(part.up)
                .with_scale(part.scale)
                .with_size(part.size)
                .with_rotate(DVec3::from_array(part.rotate))
                .with_translate(part.translate.map_or(DVec3::ZERO, DVec3::from_array))
                .with_fit(part.fit.map(DVec3::from_array)),
            material: part.material,
        };
        self.scene.parts.iter().map(file).collect()
    }

    /// `[reflectors]` and `[scene] occlusion`, for a scene whose nearest surface is at `nearest_z` m.
    pub fn surface_options(&self, instrument: &Instrument, nearest_z: f64) -> SurfaceOptions {
        let typed = &self.reflectors;
        let mirror = typed.surface == SurfaceKind::Smooth;
        let spacing = typed.spacing.unwrap_or_else(|| instrument.advised_spacing(nearest_z.max(0.0), mirror));
        let mut options = SurfaceOptions::new(spacing, instrument.wavelength());
        options.surface = match typed.surface {
            SurfaceKind::Diffuse => SurfaceModel::Diffuse,
            SurfaceKind::Rough => SurfaceModel::Rough(typed.roughness * instrument.wavelength()),
            SurfaceKind::Smooth => SurfaceModel::Smooth,
        };
        options.lambert = typed.shading == Shading::Lambert;
        options.occlusion = match self.scene.occlusion {
            OcclusionKind::None => Occlusion::None,
            OcclusionKind::Speaker => Occlusion::Speaker,
            OcclusionKind::Aperture => Occlusion::Aperture(instrument.array.sight_points().to_vec()),
        };
        options.speaker = instrument.viewpoint();
        options.seed = typed.seed.into();
        options.bounces = (self.scene.bounces > 0).then(|| {
            let sight = instrument.array.sight_points().to_vec();
            BounceOptions::new(self.scene.bounces, sight).with_spreading(self.medium.spreading)
        });
        let edges = EdgeOptions::new(instrument.shortest_wavelength()).with_spreading(self.medium.spreading);
        options.edges = self.scene.edges.then_some(edges);
        options
    }

    /// How the truth is traced: with the speaker and the shading of the simulation.
    pub fn truth_options(&self, instrument: &Instrument) -> TruthOptions {
        let mut options = TruthOptions::for_speaker(instrument.viewpoint());
        options.lambert = self.reflectors.shading == Shading::Lambert;
        if self.scene.occlusion == OcclusionKind::None {
            options.speaker = None;
        }
        options
    }

    /// `[detection]`, `[medium]` and `[array]` for the simulation.
    pub fn simulate_options(&self) -> SimulateOptions {
        // The noise has a random stream of its own, independent of the surfaces' phases.
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
            electronics: self.electronics(),
            noise: self.detection.snr_db.map(|snr_db| Noise { snr_db, seed }),
            tolerance: self.detection.tolerance,
            dwell: self.recording.dwell,
            code: self.source_code(),
        }
    }

    /// First and last voxel of `[grid]` along x, y and z, m; what is left out follows from the scene's bounding box.
    pub(crate) fn grid_ends(
        &self,
        instrument: &Instrument,
        scene: Option<(DVec3, DVec3)>,
    ) -> Result<[[f64; 2]; 3]> {
        let typed = &self.grid;
        let from_scene = |axis: usize| {
            let (low, high) = scene.ok_or_else(|| {
                let problem = "is missing or incomplete, and there is no scene to derive it from; give a run file (-c) with \
                               x, y and z as [first, last] in metres, for example";
                Error::input("[grid]", format!("{problem}\n\n{}", instrument.suggested_grid_table()))
            })?;
            let margin = ((high[axis] - low[axis]) * MARGIN).max(2.0 * instrument.wavelength());
            Ok([low[axis] - margin, high[axis] + margin])
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
                let high = scene.map_or(f64::NAN, |(_, high)| high.z);
                let problem = format!(
                    "is behind the array or in its plane (z up to {high:.3} m), so no grid can be derived from it; move it \
                     with `translate` or `fit`, or give [grid]"
                );
                return Err(Error::input("[scene]", problem));
            }
            [first, last]
        };
        Ok([x, y, z])
    }

    /// `[grid]`; what is left out follows from the scene's bounding box and the plan's advice.
    ///
    /// # Errors
    /// Invalid axes; a grid that is left out although there is no scene to derive it from.
    pub fn voxels(&self, instrument: &Instrument, scene: Option<(DVec3, DVec3)>) -> Result<Grid> {
        let [x, y, z] = self.grid_ends(instrument, scene)?;
        let advised = instrument.advised_pitch(z[0].max(instrument.wavelength()));
        let pitch = self.grid.pitch.unwrap_or(advised);
        let axis = |name: &str, [first, last]: [f64; 2], pitch: f64| {
            Axis::spanning(first, last, pitch).map_err(|error| error.at(format!("[grid] {name}")))
        };
        Ok(Grid { x: axis("x", x, pitch[0])?, y: axis("y", y, pitch[1])?, z: axis("z", z, pitch[2])? })
    }

    /// `[reconstruct]` and `[refine]`.
    pub fn reconstruct_options(&self) -> ReconstructOptions {
        let mut options = ReconstructOptions::new(self.reconstruct.method, self.reconstruct.window);
        options.tolerance = self.reconstruct.tolerance;
        options.compensate = self.reconstruct.compensate;
        options.refine = self.refine_options();
        options.sub_band = self.reconstruct.sub_band.unwrap_or(1) as usize;
        options.motion = self.frame_motion();
        options
    }

    /// `[refine]`; `None` where the volume is not refined.
    pub fn refine_options(&self) -> Option<RefineOptions> {
        let RefineTable { method, steps, sparsity, noise } = self.refine;
        let options = RefineOptions::new(method.solver()?);
        Some(options.with_steps(steps as usize).with_sparsity(sparsity).with_noise(noise))
    }

    /// `[depth] view`: the pixels, or `None` for those of the grid; `camera` is the one at which the array is placed.
    ///
    /// # Errors
    /// A perspective view whose field of view neither the run file nor the camera gives.
    pub fn raster(&self, camera: Option<CameraView>) -> Result<Option<Raster>> {
        if self.depth.view == View::Orthographic {
            return Ok(None);
        }
        let fov = self.depth.fov.or_else(|| camera.map(|camera| camera.vertical_field_of_view)).ok_or_else(|| {
            Error::input(
                "[depth] fov",
                "is missing: a perspective view needs its vertical field of view in degrees, unless the array is at a \
                 perspective camera of a glTF scene ([scene] sensor = \"camera:NAME\")",
            )
        })?;
        let shape = camera.and_then(|camera| camera.aspect_ratio).unwrap_or(1.0);
        let advised = [(shape * ROWS).round().clamp(1.0, 64.0 * ROWS) as usize, ROWS as usize];
        let pixels = self.depth.pixels.map_or(advised, |pixels| pixels.map(|n| n as usize));
        Raster::camera(fov, pixels).map(Some).map_err(|error| error.at("[depth] fov"))
    }

    /// `[depth]`, for what can be resolved and the sidelobes that there are.
    pub fn depth_options(
        &self,
        resolution: impl Into<Resolution>,
        sidelobes: ArraySidelobes,
    ) -> DepthOptions {
        let (typed, refined) = (&self.depth, self.refine.method != RefineMethod::None);
        let mut options = DepthOptions::new(resolution).adapted_to(sidelobes, refined);
        options.confidence_db = typed.confidence_db.unwrap_or(options.confidence_db);
        options.rim_db = typed.rim_db.unwrap_or(options.rim_db);
        // A correlation has no phases by which parts of the band could be told apart.
        options.gate = typed.gate && self.reconstruct.method != Method::Correlation;
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
