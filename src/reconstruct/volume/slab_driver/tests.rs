//! Every depth comes once and in order, from wherever a run resumes; errors come through; progress adds up.

use super::*;
use crate::error::Error;
use crate::grid::{Axis, Volume};
use crate::progress::{Event, Silent};
use crate::reconstruct::Method;
use std::sync::atomic::{AtomicU64, Ordering};

const INFO: ReconstructionInfo = ReconstructionInfo::plain(Method::Direct, 0.0);

fn grid() -> Grid {
    let axis = |count| Axis { first: 1.0, pitch: 0.1, count };
    Grid { x: axis(3), y: axis(2), z: axis(10) }
}

/// Planes of six samples that tell their depth.
fn numbered(depths: Range<usize>) -> Vec<Complex32> {
    (6 * depths.start..6 * depths.end).map(|i| Complex32::new(i as f32, 1.0)).collect()
}

fn fill(depths: Range<usize>, planes: &mut [Complex32]) {
    planes.copy_from_slice(&numbered(depths));
}

/// A volume that contains the first depths and expects the others in order.
struct OrderedVolume {
    volume: Volume,
    done: usize,
}

impl VolumeSink for OrderedVolume {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        assert_eq!(*info, INFO);
        self.volume.begin(info)?;
        self.volume.take(0, &numbered(0..self.done))
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        assert!(first <= self.done && 6 * (self.done - first) < planes.len(), "{first} after {}", self.done);
        self.volume.take(first, planes)?;
        self.done = first + planes.len() / 6;
        Ok(())
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        depths.start.max(self.done).min(depths.end)..depths.end
    }
}

/// Adds up what is announced and what is done.
#[derive(Default)]
struct Tally {
    total: AtomicU64,
    done: AtomicU64,
}

impl Observer for Tally {
    fn event(&self, event: Event<'_>) {
        match event {
            Event::Started { total, .. } => self.total.fetch_add(total, Ordering::Relaxed),
            Event::Advanced { amount } => self.done.fetch_add(amount, Ordering::Relaxed),
            Event::Finished => 0,
        };
    }
}

#[test]
fn all_depths_come_once_in_order_from_wherever_a_run_resumes() {
    for (thickness, at_once) in [(1, 1), (3, 1), (3, 2), (5, 1), (4, 3), (10, 1), (17, 1)] {
        for (done, divisible) in (0..=10).flat_map(|done| [(done, false), (done, true)]) {
            let mut sink = OrderedVolume { volume: Volume { grid: grid(), samples: Vec::new() }, done };
            let (tally, grid) = (Tally::default(), grid());
            let mut driver = SlabDriver::even(&grid, thickness, |depths| 7 * depths as u64, &tally);
            (driver.at_once, driver.other_work, driver.divisible) = (at_once, 5, divisible);
            advance(&tally, 5).unwrap();
            let slabs = driver.slabs.clone();
            let run = driver.run(INFO, &mut sink, |part, depths, planes| {
                let first = slabs[part.start].depths.start;
                let first = if divisible { first.max(done) } else { first };
                assert_eq!((first, slabs[part.end - 1].depths.end), (depths.start, depths.end));
                assert!(part.len() <= at_once && depths.end > done, "{depths:?} was there");
                fill(depths.clone(), planes);
                advance(&tally, 7 * depths.len() as u64)
            });
            assert_eq!(run, Ok(INFO));
            assert_eq!(sink.volume.samples, numbered(0..10), "{at_once} slabs of {thickness} from {done}");
            let [total, done] = [tally.total, tally.done].map(AtomicU64::into_inner);
            assert_eq!((total, done), (75, 75));
        }
    }
}

/// Has no room beyond the first depths.
struct Full;

impl VolumeSink for Full {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, _: &[Complex32]) -> Result<()> {
        if first == 0 { Ok(()) } else { Err(Error::io("disk", "full")) }
    }
}

#[test]
fn errors_of_the_sink_and_of_the_computation_end_it() {
    let (grid, full) = (grid(), Err(Error::io("disk", "full")));
    let run = |thickness: usize, fails_at: usize| {
        let mut computed = Vec::new();
        let driver = SlabDriver::even(&grid, thickness, |_| 1, &Silent);
        let result = driver.run(INFO, &mut Full, |_, depths, _| {
            computed.push(depths.start);
            if depths.start == fails_at { Err(Error::Interrupted) } else { Ok(()) }
        });
        (result, computed)
    };
    // While the next are computed, and after the last.
    assert_eq!(run(2, 99), (full.clone(), vec![0, 2, 4]));
    assert_eq!(run(5, 99), (full, vec![0, 5]));
    assert_eq!(run(2, 0), (Err(Error::Interrupted), vec![0]));
    assert_eq!(run(10, 99), (Ok(INFO), vec![0]));
}
