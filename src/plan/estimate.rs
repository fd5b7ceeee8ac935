//! What a job takes of the machine: operations and seconds by method, and bytes by array.
//!
//! Takes the sizes of a job's arrays and of its method's; gives a `JobEstimate`, whose memory is the stage with the largest
//! sum of arrays. Unlike the rest of a plan this depends on the machine and the number of threads, so it is shown and
//! enforced but never part of a result.

use crate::acquisition::Instrument;
use crate::error::{Error, Result, gib};
use crate::grid::Grid;
use crate::reconstruct::{Estimate, Estimates, Method, ReconstructOptions, estimate};
use crate::wave::simd::{LANES, Lanes, lane_phasors};
use serde::Serialize;
use std::fmt;
use std::time::Instant;

/// Bytes of the program itself: its code, libraries, tables and threads, as far as a job touches them.
const PROGRAM_BYTES: u64 = 20 << 20;

/// A stage of a job, by what is in memory then.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum JobStage {
    /// A mesh is read and the tree over its triangles built.
    Loading,
    /// Reflectors are placed on its surfaces.
    Sampling,
    /// Samples are simulated.
    Simulation,
    /// Voxels are reconstructed.
    Reconstruction,
    /// Depths are found in the volume.
    Depth,
    /// Files are written.
    Writing,
}

impl fmt::Display for JobStage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Loading => "loading the mesh",
            Self::Sampling => "sampling surfaces",
            Self::Simulation => "simulating",
            Self::Reconstruction => "reconstructing",
            Self::Depth => "locating depth",
            Self::Writing => "writing",
        })
    }
}

/// Bytes of an array, or of several of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct MemoryItem {
    /// What it holds: `samples`, `volume`.
    pub name: &'static str,
    /// Its size, bytes.
    pub bytes: u64,
}

/// The memory that a job takes at one stage: the sum of its large arrays, and the program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct MemoryEstimate {
    /// The stage.
    pub stage: JobStage,
    /// What is in memory then; nothing that is empty.
    pub items: Vec<MemoryItem>,
}

impl MemoryEstimate {
    fn new(stage: JobStage, items: &[(&'static str, u64)]) -> Self {
        let items = items.iter().chain(&[("program", PROGRAM_BYTES)]);
        let items = items.filter(|(_, bytes)| *bytes > 0).map(|&(name, bytes)| MemoryItem { name, bytes });
        Self { stage, items: items.collect() }
    }

    /// Bytes of everything; saturates rather than overflow.
    pub fn total(&self) -> u64 {
        self.items.iter().fold(0, |sum, item| sum.saturating_add(item.bytes))
    }

    /// Refuses a job that takes more than `limit` bytes; `ways` returns how its later stages would fit.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] with the stage, its arrays and what would make it fit.
    pub(crate) fn check(
        &self,
        instrument: &Instrument,
        limit: Option<u64>,
        ways: impl FnOnce(u64) -> Vec<String>,
    ) -> Result<()> {
        let Some(limit) = limit.filter(|limit| self.total() > *limit) else { return Ok(()) };
        let scene = self.items.iter().filter(|item| item.name == "scene").map(|item| item.bytes).sum::<u64>();
        let mostly_scene = scene > self.total() / 2;
        let ways = match self.stage {
            JobStage::Loading => "decimate the mesh (sound resolves about a cm)".to_owned(),
            _ if mostly_scene || self.stage == JobStage::Sampling => {
                "use a larger [reflectors] spacing or a list of fewer points, and check the scene's unit and scale"
                    .to_owned()
            }
            _ => {
                let (frequencies, microphones) = (instrument.sweep.len(), instrument.array.len());
                let fewer = format!("take less than {frequencies} frequencies x {microphones} microphones");
                [ways(limit), vec![fewer]].concat().join("; ")
            }
        };
        Err(Error::input(
            "memory",
            format!(
                "this job takes about {} even if as little as possible is worked on at a time ({self}), and {} may be used \
                 here (--memory sets another limit); {ways}",
                gib(self.total()),
                gib(limit)
            ),
        ))
    }
}

/// As in `reconstructing: samples 31 MiB, volume 16 MiB, program 20 MiB`.
impl fmt::Display for MemoryEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let items: Vec<String> = self.items.iter().map(|i| format!("{} {}", i.name, gib(i.bytes))).collect();
        write!(f, "{}: {}", self.stage, items.join(", "))
    }
}

/// Bytes of a job's arrays other than its method's; 0 where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub(crate) struct JobArrays {
    /// The microphones' positions and weights, in every stage; 0 below a MiB, which the program's own bytes cover.
    pub(crate) microphones: u64,
    /// A scene: its triangles and the tree over them, or its list of reflectors.
    pub(crate) scene: u64,
    /// The same while the tree is built.
    pub(crate) loading: u64,
    /// Candidates and reflectors while its surfaces are sampled.
    pub(crate) sampling: u64,
    /// Samples: a simulated cube, or a file that cannot be read in order.
    pub(crate) samples: u64,
    /// Sums and weights while samples are simulated.
    pub(crate) simulation: u64,
    /// The volume, unless it is written depth by depth.
    pub(crate) volume: u64,
    /// Finished depths that wait to be written to the checkpoint.
    pub(crate) checkpoint: u64,
    /// Passes over the volume in which depths are found.
    pub(crate) depth: u64,
    /// Planes of the files that are written from the volume.
    pub(crate) output: u64,
}

/// Bytes of a microphone: its position, and weights of a window over the array in both precisions.
const BYTES_PER_MICROPHONE: u64 = 24 + 12;

impl JobArrays {
    /// Those of a measurement with this instrument, `samples` bytes of which are in memory.
    pub(crate) fn measured(instrument: &Instrument, samples: u64) -> Self {
        let microphones = BYTES_PER_MICROPHONE.saturating_mul(instrument.array.len() as u64);
        let microphones = if microphones < 1 << 20 { 0 } else { microphones };
        Self { microphones, samples, ..Self::default() }
    }

    /// The memory of reconstruction, whose method takes `method` bytes.
    fn reconstruction(&self, method: u64) -> MemoryEstimate {
        let arrays = [
            ("microphones", self.microphones),
            ("scene", self.scene),
            ("samples", self.samples),
            ("volume", self.volume),
            ("checkpoint", self.checkpoint),
            ("method", method),
        ];
        MemoryEstimate::new(JobStage::Reconstruction, &arrays)
    }

    /// The memory of the stage that takes most, of a job whose method takes `method` bytes.
    pub(crate) fn peak(&self, method: u64) -> MemoryEstimate {
        let (scene, samples, volume) =
            (("scene", self.scene), ("samples", self.samples), ("volume", self.volume));
        let microphones = ("microphones", self.microphones);
        let mut peak = self.reconstruction(method);
        for other in [
            MemoryEstimate::new(JobStage::Loading, &[microphones, ("mesh and tree", self.loading)]),
            MemoryEstimate::new(JobStage::Sampling, &[microphones, scene, ("candidates", self.sampling)]),
            MemoryEstimate::new(
                JobStage::Simulation,
                &[microphones, scene, samples, ("sums", self.simulation)],
            ),
            MemoryEstimate::new(
                JobStage::Depth,
                &[microphones, scene, samples, volume, ("depth", self.depth)],
            ),
            MemoryEstimate::new(JobStage::Writing, &[microphones, volume, ("output", self.output)]),
        ] {
            if other.total() > peak.total() {
                peak = other;
            }
        }
        peak
    }

    /// The bytes that `limit` leaves to the method: [`ReconstructOptions::memory`].
    pub(crate) fn left_for_method(&self, limit: Option<u64>) -> Option<u64> {
        limit.map(|limit| limit.saturating_sub(self.reconstruction(0).total()))
    }
}

/// What a job takes of this machine.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub(crate) struct JobEstimate {
    /// Every method, possible here or not.
    pub(crate) methods: Vec<Estimate>,
    /// Which of them the job takes, as an index.
    pub(crate) chosen: usize,
    /// Worker threads.
    pub(crate) threads: usize,
    /// The memory at the peak.
    pub(crate) memory: MemoryEstimate,
}

/// Computes what a job takes. Costs milliseconds.
///
/// # Errors
/// Those of [`estimate`].
pub(crate) fn estimate_job(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    arrays: &JobArrays,
    threads: usize,
) -> Result<JobEstimate> {
    let Estimates { methods, chosen } = estimate(instrument, grid, options, threads)?;
    let memory = arrays.peak(methods[chosen].bytes);
    Ok(JobEstimate { methods, chosen, threads, memory })
}

impl JobEstimate {
    /// Seconds of each method on this machine, by a measurement of a few milliseconds.
    pub(crate) fn seconds(&self) -> Vec<f64> {
        let rate = operations_per_second();
        self.methods.iter().map(|method| method.operations / rate).collect()
    }

    /// Refuses a job that cannot fit, however little of it is worked on at a time.
    ///
    /// # Errors
    /// As [`MemoryEstimate::check`], with what else would make it fit.
    pub(crate) fn check_memory(
        &self,
        instrument: &Instrument,
        grid: &Grid,
        arrays: &JobArrays,
        limit: Option<u64>,
    ) -> Result<()> {
        let ways = |limit: u64| {
            // A far-field image is another one.
            let others = self.methods.iter().filter(|m| m.obstacle.is_none() && m.method != Method::Linear);
            let fitting =
                others.map(|m| (m, arrays.peak(m.bytes).total())).filter(|(_, bytes)| *bytes <= limit);
            let mut ways: Vec<String> = fitting
                .map(|(m, bytes)| format!("[reconstruct] method = \"{}\" needs {}", m.method, gib(bytes)))
                .collect();
            if arrays.volume > 0 && arrays.depth == 0 {
                ways.push(
                    "a volume written as .npz, .zarr, .vti or .nrrd is never in memory as a whole".to_owned(),
                );
            }
            if arrays.samples > 0 {
                let way = "a cube in a file (`simulate`, then `reconstruct`) is never in memory as a whole";
                ways.push(way.to_owned());
            }
            let [n_z, n_y, n_x] = grid.shape();
            ways.push(format!("make the grid of {n_x} x {n_y} x {n_z} voxels smaller or its pitch larger"));
            ways
        };
        self.memory.check(instrument, limit, ways)
    }
}

/// Operations of the model per phasor of the kernel that is timed.
const PER_PHASOR: f64 = 25.0;

/// How long all threads are timed together, s: those that share a core take turns.
const TIMED: f64 = 4e-3;

/// Seconds that so many operations of the model take all threads on this machine.
pub(crate) fn seconds_of(operations: f64) -> f64 {
    operations / operations_per_second()
}

/// Floating-point operations per second of all threads on this machine, by a measurement of a few milliseconds. It only ever
/// turns operations into seconds to be shown.
fn operations_per_second() -> f64 {
    let lengths: Vec<[f64; LANES]> =
        (0..512).map(|i| std::array::from_fn(|l| 1.0 + f64::from(i) * 0.003 + l as f64 * 0.1)).collect();
    let of_thread = |_: rayon::BroadcastContext| {
        let mut phasors = vec![Lanes::ZERO; lengths.len()];
        let (begun, mut count) = (Instant::now(), 0);
        loop {
            lane_phasors(&[58.3; LANES], &lengths, &mut phasors);
            count += lengths.len() * LANES;
            let seconds = begun.elapsed().as_secs_f64();
            if seconds > TIMED {
                return count as f64 / seconds;
            }
        }
    };
    PER_PHASOR * rayon::broadcast(of_thread).into_iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::super::tests::test_instrument;
    use super::*;
    use crate::acquisition::{DataCube, Detection};
    use crate::grid::Axis;
    use crate::named::assert_names;
    use crate::reconstruct::reconstruct;
    use crate::wave::phasor;

    #[test]
    fn what_memory_there_is_is_kept_to_and_changes_no_byte() {
        let instrument = &test_instrument(31, 0.9, 40.0, Detection::Quadrature);
        let lateral = Axis { first: -0.9, pitch: 0.03, count: 61 };
        let grid = Grid { x: lateral, y: lateral, z: Axis { first: 0.5, pitch: 0.02, count: 40 } };
        let samples = (0..instrument.sweep.len() * instrument.array.len())
            .map(|i| phasor(i as f64 * 0.618_034))
            .collect();
        let cube = DataCube::new(instrument.clone(), samples).expect("finite");
        let arrays = JobArrays { volume: grid.volume_bytes(), ..JobArrays::default() };
        for (method, tolerance) in [(Method::Convolution, 1e-4), (Method::Convolution, 0.0)] {
            let mut options = ReconstructOptions::new(method, crate::reconstruct::Window::None);
            options.tolerance = tolerance;
            let estimated = |options: &ReconstructOptions| {
                estimate_job(instrument, &grid, options, &arrays, 4).expect("an estimate")
            };
            let usual = estimated(&options).memory.total();
            let volume = reconstruct(&cube, &grid, &options).expect("fits").volume;
            options.memory = Some(0);
            let least = estimated(&options).memory.total();
            assert!(least < usual);
            options.memory = arrays.left_for_method(Some(least));
            let tight = estimated(&options);
            assert_eq!(tight.memory.total(), least);
            let checked = |limit: u64| tight.check_memory(instrument, &grid, &arrays, Some(limit));
            assert!(checked(least).is_ok());
            let refused = checked(least - 1).expect_err("too much").to_string();
            assert_names(refused, &["memory", ".npz", "volume", "61 x 61 x 40", "961 microphones"]);
            assert_eq!(reconstruct(&cube, &grid, &options).expect("fits").volume, volume);
        }
    }

    #[test]
    fn the_peak_is_the_stage_of_most_bytes() {
        let arrays =
            JobArrays { scene: 100, loading: 210, samples: 30, simulation: 20, ..JobArrays::default() };
        let peak = arrays.peak(0);
        assert_eq!((peak.stage, peak.total()), (JobStage::Loading, PROGRAM_BYTES + 210));
        let peak = arrays.peak(90);
        assert_eq!((peak.stage, peak.total()), (JobStage::Reconstruction, PROGRAM_BYTES + 220));
        let peak = JobArrays { sampling: 300, ..arrays }.peak(90);
        assert_eq!((peak.stage, peak.total()), (JobStage::Sampling, PROGRAM_BYTES + 400));
        for (stage, way) in [(JobStage::Loading, "mesh"), (JobStage::Sampling, "[reflectors] spacing")] {
            let memory = MemoryEstimate::new(stage, &[("a", u64::MAX)]);
            assert_eq!(memory.total(), u64::MAX, "no overflow");
            let instrument = test_instrument(2, 1.0, 40.0, Detection::Quadrature);
            assert!(memory.check(&instrument, None, |_| Vec::new()).is_ok(), "a limit that is not known");
            let refused = memory.check(&instrument, Some(1 << 20), |_| Vec::new());
            let refused = refused.expect_err("too much").to_string();
            assert_names(refused, &["memory", "1 MiB", way]);
        }
    }
}
