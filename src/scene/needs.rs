//! What reading a mesh takes of memory, found from what is cheap to know of its file before it is read.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::occlusion::SurfaceTree;
use super::{Triangle, files};
use crate::error::{Error, Result, gib};

/// What reading a mesh takes of memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct MeshNeeds {
    /// Triangles, those without area included.
    pub triangles: u64,
    /// Whether the file declares their number; else it is estimated from samples of the file.
    pub counted: bool,
    /// Bytes on the disk, those of a glTF's buffers aside.
    pub file: u64,
    /// Bytes at the peak of reading beside the triangles: the file, and what its format makes of it on the way.
    pub reading: u64,
}

/// Bytes per triangle that the C library keeps for itself of what is freed on the way, and at the most.
const KEPT_BACK: u64 = 8;
const MOST_KEPT_BACK: u64 = 32 << 20;

impl MeshNeeds {
    /// The needs of a file of which so many triangles were kept: no less than was held to the limit.
    pub(super) fn with(self, triangles: usize) -> Self {
        Self { triangles: self.triangles.max(triangles as u64), ..self }
    }

    /// Bytes at the peak: while the file is read, or while the tree is built.
    pub fn peak(&self) -> u64 {
        let beside = self.reading.max(self.triangles.saturating_mul(SurfaceTree::BUILDING));
        let kept_back = self.triangles.saturating_mul(KEPT_BACK).min(MOST_KEPT_BACK);
        self.triangles.saturating_mul(TRIANGLE).saturating_add(beside).saturating_add(kept_back)
    }

    /// Bytes that the scene keeps: its triangles and their tree.
    pub fn held(&self) -> u64 {
        self.triangles.saturating_mul(TRIANGLE + SurfaceTree::HELD)
    }

    /// Refuses a mesh that takes more than the `limit`.
    pub(super) fn check(&self, path: &Path, limit: Option<u64>) -> Result<()> {
        let Some(limit) = limit.filter(|limit| self.peak() > *limit) else { return Ok(()) };
        let about = if self.counted { "" } else { "some " };
        Err(Error::input(
            path.display(),
            format!(
                "reading its {about}{} triangles ({} on the disk) takes about {}, and {} may be used here for it (--memory \
                 sets another limit); decimate the mesh (sound resolves about a cm), or leave out what the array does \
                 not see",
                self.triangles,
                gib(self.file),
                gib(self.peak()),
                gib(limit)
            ),
        ))
    }
}

/// Bytes of a triangle.
const TRIANGLE: u64 = size_of::<Triangle>() as u64;

/// A file of which a little is read.
pub(super) struct Glimpse {
    file: File,
    /// Bytes of all of it.
    pub(super) length: u64,
}

/// Bytes of a text that are read in one place, and in how many places: all of a file of up to a megabyte.
const PLACE: u64 = 1 << 14;
const PLACES: u64 = 64;

impl Glimpse {
    pub(super) fn of(path: &Path) -> Result<Self> {
        let (file, length) = files::open(path)?;
        Ok(Self { file, length })
    }

    /// So many bytes from a place, or as many as there are; none where they cannot be read.
    pub(super) fn bytes(&mut self, from: u64, count: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        let read = self
            .file
            .seek(SeekFrom::Start(from))
            .and_then(|_| (&mut self.file).take(count).read_to_end(&mut bytes));
        if read.is_ok() { bytes } else { Vec::new() }
    }

    /// The file from a place on.
    pub(super) fn from(&mut self, place: u64) -> Option<&mut File> {
        self.file.seek(SeekFrom::Start(place)).ok().map(|_| &mut self.file)
    }

    /// Shows some whole lines of a text, and says how many times as many there are in all of it.
    pub(super) fn lines(&mut self, mut line: impl FnMut(&[u8])) -> f64 {
        let mut seen = 0;
        let all = self.length <= PLACE * PLACES;
        let (places, size) = if all { (1, self.length) } else { (PLACES, PLACE) };
        for place in 0..places {
            let from = if all { 0 } else { (self.length - size) / (places - 1) * place };
            let bytes = self.bytes(from, size);
            let mut lines: Vec<&[u8]> = bytes.split_inclusive(|&byte| byte == b'\n').collect();
            // The first may have begun before, and the last may end later.
            let first = usize::from(from > 0).min(lines.len());
            if lines.last().is_some_and(|last| !last.ends_with(b"\n")) && !all {
                lines.pop();
            }
            for whole in lines.iter().skip(first) {
                seen += whole.len();
                line(whole.trim_ascii());
            }
        }
        if seen == 0 { 0.0 } else { self.length as f64 / seen as f64 }
    }
}

/// So many times as many of what was counted in samples.
pub(super) fn scaled(count: u64, factor: f64) -> u64 {
    (count as f64 * factor).ceil() as u64
}
