//! Nodes that processes with neighbouring depths share: one file for each boundary, which one of the two writes.

use super::segment::UnfinishedSegment;
use super::{Checkpoint, GracefulStop, Identity, SharedBlocks, Stage};
use crate::blocks::NodeStore;
use crate::error::Result;
use num_complex::Complex32;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fs;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Those of a job's volume. The files that were read are deleted by [`SharedNodes::forget`]: there is nobody else who needs
/// them.
pub(crate) struct SharedNodes<'a> {
    checkpoint: &'a Checkpoint,
    identity: &'a Identity,
    stop: &'a GracefulStop<'a>,
    found: Mutex<HashMap<usize, SharedBlocks>>,
    /// Those that are being written; none once one could not be.
    unfinished: Mutex<HashMap<usize, Option<UnfinishedSegment>>>,
}

impl<'a> SharedNodes<'a> {
    /// `stop` is the stage's observer.
    pub(crate) fn new(
        checkpoint: &'a Checkpoint,
        identity: &'a Identity,
        stop: &'a GracefulStop<'a>,
    ) -> Self {
        Self { checkpoint, identity, stop, found: Mutex::default(), unfinished: Mutex::default() }
    }

    /// Deletes what this process has read, once it has written all that it made of that.
    pub(crate) fn forget(self) {
        let Some(place) = &self.checkpoint.place else { return };
        for boundary in locked(&self.found).keys() {
            let _ = fs::remove_file(place.nodes_of(&self.of(*boundary)));
        }
    }

    fn of(&self, boundary: usize) -> Identity {
        let mut identity = self.identity.clone();
        identity.text("nodes");
        identity.numbers([boundary as f64].into_iter());
        identity
    }

    /// Appends a plane to a file, which gets its name with the last.
    fn append(
        &self,
        boundary: usize,
        segment: Option<UnfinishedSegment>,
        (k, plane): (u64, &[Complex32]),
        is_last: bool,
    ) -> Result<Option<UnfinishedSegment>> {
        let Some(place) = &self.checkpoint.place else { return Ok(None) };
        let identity = self.of(boundary);
        let segment = segment
            .map_or_else(|| UnfinishedSegment::new(place, &identity, 0, place.nodes_of(&identity)), Ok);
        let mut segment = segment?;
        segment.append(Stage::Nodes, k, plane, self.stop)?;
        if is_last {
            return segment.finish().map(|()| None);
        }
        Ok(Some(segment))
    }
}

fn locked<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl NodeStore for SharedNodes<'_> {
    fn is_needed(&self, depth: usize) -> bool {
        !self.checkpoint.lists(Stage::Volume, depth as u64)
    }

    fn has(&self, boundary: usize, count: usize, plane_len: usize) -> Result<bool> {
        let (checkpoint, identity) = (self.checkpoint, self.of(boundary));
        let Some(place) = &checkpoint.place else { return Ok(false) };
        let path = place.nodes_of(&identity);
        let Some(mut shared) = checkpoint.shared_at(path, (&identity, Stage::Nodes), self.stop)? else {
            return Ok(false);
        };
        let mut plane = Vec::new();
        for k in 0..count as u64 {
            plane.resize(plane_len, Complex32::ZERO);
            if !shared.read(k, &mut plane, self.stop)? {
                return Ok(false);
            }
        }
        locked(&self.found).insert(boundary, shared);
        Ok(true)
    }

    fn load(&self, boundary: usize, k: usize, plane: &mut [Complex32]) -> Result<bool> {
        let mut found = locked(&self.found);
        found.get_mut(&boundary).map_or(Ok(false), |shared| shared.read(k as u64, plane, self.stop))
    }

    fn save(&self, boundary: usize, k: usize, plane: &[Complex32], is_last: bool) {
        let mut unfinished = locked(&self.unfinished);
        let segment = match (unfinished.entry(boundary), k) {
            (Entry::Occupied(mut entry), _) => match entry.get_mut().take() {
                None => return,
                some => some,
            },
            (Entry::Vacant(_), 0) => None,
            // Without the first planes nobody can use the others.
            (Entry::Vacant(_), _) => return,
        };
        let left = self.append(boundary, segment, (k as u64, plane), is_last);
        unfinished.insert(boundary, left.unwrap_or_default());
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tests::{job, opened};
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn planes_are_there_with_the_last_and_gone_once_they_were_used() {
        let (_folder, output, identity) = job("volume.npz");
        let identity = identity.storing(Stage::Nodes, 4, 80);
        let (checkpoint, _) = opened(&output, &identity);
        let stop = GracefulStop::new(&checkpoint, &Silent);
        let nodes = || SharedNodes::new(&checkpoint, &identity, &stop);
        let plane = |k: usize| vec![Complex32::new(k as f32, 0.5); 10];
        let (writer, reader) = (nodes(), nodes());
        writer.save(7, 0, &plane(0), false);
        writer.save(7, 1, &plane(1), false);
        assert!(!reader.has(7, 3, 10).unwrap(), "not before the last");
        writer.save(7, 2, &plane(2), true);
        // One that begins in the middle is never there, nor is one of planes that are too large.
        writer.save(9, 1, &plane(1), true);
        assert!(!reader.has(9, 1, 10).unwrap() && !reader.has(8, 3, 10).unwrap());
        assert!(!reader.has(7, 4, 10).unwrap() && !reader.has(7, 3, 9).unwrap());
        assert!(reader.has(7, 3, 10).unwrap());
        let mut read = plane(9);
        for k in [2, 0, 1] {
            assert!(reader.load(7, k, &mut read).unwrap() && read == plane(k));
        }
        assert!(!reader.load(7, 3, &mut read).unwrap() && !nodes().load(7, 0, &mut read).unwrap());
        assert!(nodes().has(7, 3, 10).unwrap());
        reader.forget();
        assert!(!nodes().has(7, 3, 10).unwrap(), "it was used");
    }

    #[test]
    fn damaged_planes_are_as_good_as_none() {
        let (folder, output, identity) = job("volume.npz");
        let identity = identity.storing(Stage::Nodes, 4, 80);
        let (checkpoint, _) = opened(&output, &identity);
        let stop = GracefulStop::new(&checkpoint, &Silent);
        let nodes = SharedNodes::new(&checkpoint, &identity, &stop);
        for k in 0..2 {
            nodes.save(3, k, &[Complex32::ONE; 10], k == 1);
        }
        assert!(nodes.has(3, 2, 10).unwrap());
        let files = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
        let file = files.filter(|path| path.extension().is_some_and(|end| end == "nodes")).last().unwrap();
        let mut bytes = fs::read(&file).unwrap();
        let at = bytes.len() - 3;
        bytes[at] ^= 1;
        fs::write(&file, &bytes).unwrap();
        assert!(!nodes.has(3, 2, 10).unwrap() && nodes.has(3, 1, 10).unwrap());
        fs::write(&file, &bytes[..100]).unwrap();
        assert!(!nodes.has(3, 1, 10).unwrap());
    }
}
