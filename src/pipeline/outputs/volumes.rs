//! Volume files: at once, or depth by depth.

use crate::acquisition::Instrument;
use crate::config::{OutputTable, RunFile};
use crate::error::{Error, Result};
use crate::export::volume_exr::write_volume_exr;
use crate::export::volume_npz::stream_volume_npz;
use crate::export::volume_nrrd::stream_volume_nrrd;
use crate::export::volume_vdb::write_volume_vdb;
use crate::export::volume_vti::stream_volume_vti;
use crate::export::volume_zarr::stream_volume_zarr;
use crate::export::{Encoding, VolumeFile, fits_float16};
use crate::files::extension;
use crate::files::zarr::EncodedShards;
use crate::grid::{Grid, Volume, VolumeView};
use crate::pipeline::facts::{attributes, image_facts, sidelobes};
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use num_complex::Complex32;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The list of one file.
fn one(path: &Path, written: Result<()>) -> Result<Vec<PathBuf>> {
    written.map(|()| vec![path.to_path_buf()])
}

/// Whether a file of this name needs the complete volume in memory.
pub(in crate::pipeline) fn needs_all(path: &Path) -> bool {
    matches!(extension(path).as_str(), "exr" | "vdb")
}

/// Volume files in progress: those that are written depth by depth, and the volume for those of other formats.
pub(in crate::pipeline) struct VolumeFiles<'a> {
    instrument: &'a Instrument,
    run: &'a RunFile,
    paths: &'a [PathBuf],
    facts: Value,
    growing: Vec<(&'a Path, VolumeFile<'a>)>,
    whole: Volume,
    shards: &'a dyn EncodedShards,
}

impl<'a> VolumeFiles<'a> {
    pub(in crate::pipeline) fn new(
        instrument: &'a Instrument,
        run: &'a RunFile,
        grid: Grid,
        paths: &'a [PathBuf],
        shards: &'a dyn EncodedShards,
    ) -> Self {
        let whole = Volume { grid, samples: Vec::new() };
        Self { instrument, run, paths, facts: Value::Null, growing: Vec::new(), whole, shards }
    }

    /// Completes all files; returns their names in the order of the request.
    pub(in crate::pipeline) fn finish(self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        let mut growing = self.growing;
        for path in self.paths {
            match growing.iter().position(|(grown, _)| grown == path) {
                Some(index) => files.extend(one(path, growing.swap_remove(index).1.finish())?),
                None => files.extend(write_volume(path, &self.whole, &self.run.output, &self.facts)?),
            }
        }
        Ok(files)
    }
}

impl VolumeSink for VolumeFiles<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        let sidelobes = sidelobes(self.instrument, self.run);
        self.facts = image_facts(self.instrument, self.run, info, sidelobes);
        for path in self.paths.iter().filter(|path| !needs_all(path)) {
            let how = (&self.run.output, &self.facts);
            let file = stream_volume(path, &self.whole.grid, how, Some(self.shards))?;
            self.growing.push((path, file));
        }
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        for (_, file) in &mut self.growing {
            file.take(planes)?;
        }
        let needed = self.paths.iter().any(|path| needs_all(path));
        if needed { self.whole.take(first, planes) } else { Ok(()) }
    }
}

/// Begins a volume file in the format of the path's extension, to be written depth by depth; of a store those shards are not
/// encoded that there are.
fn stream_volume<'a>(
    path: &Path,
    grid: &Grid,
    (output, facts): (&OutputTable, &Value),
    shards: Option<&'a dyn EncodedShards>,
) -> Result<VolumeFile<'a>> {
    match extension(path).as_str() {
        "npz" => stream_volume_npz(path, *grid, facts),
        "zarr" => stream_volume_zarr(path, grid, output.components, facts, output.compression, shards),
        "vti" => stream_volume_vti(path, grid, output.components, &attributes(facts)),
        "nrrd" => stream_volume_nrrd(path, grid, &attributes(facts), output.compression),
        _ => Err(Error::input(
            path.display(),
            "volumes are written as .npz, .zarr, .exr, .vti, .nrrd or .vdb; give one of these extensions",
        )),
    }
}

/// Writes a volume in the format of the path's extension, with the settings of `[output]`; returns the files written.
///
/// # Errors
/// An extension other than `.exr`, `.npz`, `.zarr`, `.nrrd`, `.vdb` or `.vti`; a file that cannot be written.
pub fn write_volume<'v>(
    path: &Path,
    volume: impl Into<VolumeView<'v>>,
    output: &OutputTable,
    facts: &Value,
) -> Result<Vec<PathBuf>> {
    write_volume_with(path, volume, (output, facts), None)
}

/// The same, with shards of a store that are encoded already.
pub(super) fn write_volume_with<'v>(
    path: &Path,
    volume: impl Into<VolumeView<'v>>,
    (output, facts): (&OutputTable, &Value),
    shards: Option<&dyn EncodedShards>,
) -> Result<Vec<PathBuf>> {
    let volume = volume.into();
    let OutputTable { components, float16, compression, vdb_threshold_db, .. } = *output;
    let encoding = Encoding { float16: float16 && fits_float16(volume.peak()), compression };
    match extension(path).as_str() {
        "exr" => write_volume_exr(path, volume, components, &attributes(facts), encoding),
        "vdb" => one(path, write_volume_vdb(path, volume, vdb_threshold_db, &attributes(facts), compression)),
        _ => {
            let mut file = stream_volume(path, &volume.grid, (output, facts), shards)?;
            file.take(volume.samples)?;
            one(path, file.finish())
        }
    }
}
