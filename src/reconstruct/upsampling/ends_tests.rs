//! Runs of depths that share the nodes about their boundaries, against all depths at once.

#![allow(clippy::unwrap_used)]

use super::ends::Ends;
use super::tests::{axis, cube, options, scattered};
use super::*;
use crate::blocks::NodeStore;
use crate::error::Result;
use crate::grid::Volume;
use crate::reconstruct::numerics::AxisWeights;
use crate::reconstruct::{Method, ReconstructionInfo, VolumeSink, needed_among, reconstruct};
use crate::wave::Geometry;
use num_complex::Complex32;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Mutex;

/// Planes by boundary and number, and the boundaries that are complete.
#[derive(Default)]
struct InMemory {
    planes: Mutex<HashMap<(usize, usize), Vec<Complex32>>>,
    complete: Mutex<Vec<usize>>,
    not_needed: Option<usize>,
}

impl NodeStore for InMemory {
    fn is_needed(&self, depth: usize) -> bool {
        self.not_needed != Some(depth)
    }

    fn has(&self, boundary: usize, count: usize, plane_len: usize) -> Result<bool> {
        let planes = self.planes.lock().unwrap();
        let is_there = |k| planes.get(&(boundary, k)).is_some_and(|plane| plane.len() == plane_len);
        Ok(self.complete.lock().unwrap().contains(&boundary) && (0..count).all(is_there))
    }

    fn load(&self, boundary: usize, k: usize, plane: &mut [Complex32]) -> Result<bool> {
        let planes = self.planes.lock().unwrap();
        let stored = planes.get(&(boundary, k));
        stored.inspect(|stored| plane.copy_from_slice(stored));
        Ok(stored.is_some())
    }

    fn save(&self, boundary: usize, k: usize, plane: &[Complex32], is_last: bool) {
        assert!(self.planes.lock().unwrap().insert((boundary, k), plane.to_vec()).is_none(), "once");
        if is_last {
            self.complete.lock().unwrap().push(boundary);
        }
    }
}

/// Of a volume some depths, which are all that are wanted.
struct SomeDepths {
    depths: Range<usize>,
    volume: Volume,
}

impl VolumeSink for SomeDepths {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.volume.begin(info)
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        self.volume.take(first, planes)
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        needed_among(depths, |depth| self.depths.contains(&depth))
    }
}

#[test]
fn runs_of_depths_sum_the_nodes_about_a_boundary_once() {
    let grid = Grid { x: axis(-0.1, 0.002, 80), y: axis(-0.1, 0.002, 75), z: axis(0.7, 0.002, 91) };
    let cube = cube(&scattered(30), Geometry::ORIGIN, grid.position(9, 9, 30));
    let found = [1e-2, 1e-3].map(|all| Upsampling::find(&cube.instrument, &grid, ErrorBudget::new(all)));
    let along_z = |nodes: &&Upsampling| nodes.axes[2].nodes.interpolates();
    let nodes = found.iter().flatten().find(along_z).expect("the voxels are fine");
    let coarse = reconstruct(&cube, &nodes.coarse, &options(Method::Direct, 1e-2)).unwrap();
    let (plane, voxels) = (nodes.coarse.plane_len(), grid.plane_len());
    // The voxels of some depths, and how many planes of nodes were summed for them, so many at a time.
    let run = |depths: Range<usize>, at_once: usize, store: Option<&InMemory>| {
        let volume = Volume { grid, samples: Vec::new() };
        let mut sink = SomeDepths { depths: depths.clone(), volume };
        let store = store.map(|store| -> &dyn NodeStore { store });
        let mut upsampled = Resampled::new(nodes.onto_voxels(), &mut sink).unwrap().sharing(store);
        upsampled.begin(&coarse.info()).unwrap();
        let mut summed = 0;
        for first in (0..nodes.coarse.z.count).step_by(at_once) {
            let all = first..(first + at_once).min(nodes.coarse.z.count);
            let wanted = upsampled.wanted(all.clone());
            // As methods do whose slabs are summed as a whole.
            let wanted = if at_once > 3 && !wanted.is_empty() { all } else { wanted };
            summed += wanted.len();
            if !wanted.is_empty() {
                let planes = &coarse.volume.samples[wanted.start * plane..wanted.end * plane];
                upsampled.take(wanted.start, planes).unwrap();
            }
        }
        upsampled.finish().unwrap();
        (sink.volume.samples[depths.start * voxels..depths.end * voxels].to_vec(), summed)
    };
    let (whole, all) = run(0..91, 1, None);
    let runs = [0..30, 30..61, 61..91];
    let alone: usize = runs.clone().map(|depths| run(depths, 1, None).1).iter().sum();
    assert!(alone > all + 10, "{alone} of {all}");
    for order in [[0, 1, 2], [2, 1, 0], [1, 0, 2], [0, 2, 1]] {
        for at_once in [1, 3, 8] {
            let store = InMemory::default();
            let mut summed = 0;
            for i in order {
                let (found, own) = run(runs[i].clone(), at_once, Some(&store));
                assert!(found == whole[runs[i].start * voxels..runs[i].end * voxels], "{order:?} {at_once}");
                summed += own;
            }
            // The first and the last need some in common, too, but share no boundary.
            let once = at_once <= 3 && order != [0, 2, 1];
            assert!(!once || summed == all, "{order:?} {at_once}: {summed} of {all}");
            assert!(summed < alone, "{order:?} {at_once}: {summed} of {alone}");
            assert_eq!(store.complete.lock().unwrap().len(), 2);
        }
    }
    // What nobody needs is not stored, nor what would be more than the depths themselves.
    let store = InMemory { not_needed: Some(61), ..InMemory::default() };
    run(runs[1].clone(), 1, Some(&store));
    run(70..72, 1, Some(&store));
    assert_eq!(*store.complete.lock().unwrap(), [30]);
}

#[test]
fn places_that_are_nodes_share_none() {
    let each = (0..9).map(|node| (node, vec![1.0]));
    let store = InMemory::default();
    let ends = Ends::new(&store, &AxisWeights::new(each), 3..6, [10, 10]);
    assert!(ends.stored_first().is_none() && ends.stored_last(&(0..9)).is_none());
}
