//! Reading a volume's amplitude from any of the formats.

use super::Amplitude;
use crate::error::{Error, Result};
use crate::export::volume_exr::read_volume_exr;
use crate::export::volume_npz::read_volume_npz;
use crate::export::volume_nrrd::read_volume_nrrd;
use crate::export::volume_vti::read_volume_vti;
use crate::export::volume_zarr::read_amplitude_zarr;
use crate::files::extension;
use std::path::Path;

impl Amplitude {
    /// Reads a volume written by this program, `.npz`, `.zarr`, `.nrrd`, `.vti` or `.exr`, of at most `limit_bytes`.
    ///
    /// The metadata of an npz and of a Zarr store are not read.
    ///
    /// # Errors
    /// Another extension; errors of the format's reader.
    pub fn read(path: &Path, limit_bytes: u64) -> Result<Self> {
        match extension(path).as_str() {
            "npz" => read_volume_npz(path, limit_bytes).and_then(|(volume, _)| Self::of(&volume)),
            "zarr" => read_amplitude_zarr(path, limit_bytes).map(|(amplitude, _)| amplitude),
            "nrrd" => read_volume_nrrd(path, limit_bytes),
            "vti" => read_volume_vti(path, limit_bytes),
            "exr" => read_volume_exr(path, limit_bytes),
            _ => Err(Error::input(
                path.display(),
                "is not a volume; a file .npz, .zarr, .nrrd, .vti or .exr was expected",
            )),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::export::volume::tests::volume;
    use crate::export::volume_exr::write_volume_exr;
    use crate::export::volume_npz::write_volume_npz;
    use crate::export::volume_nrrd::write_volume_nrrd;
    use crate::export::volume_vti::write_volume_vti;
    use crate::export::{Attribute, Components, Compression, Encoding};

    #[test]
    fn every_format_is_read_with_the_same_amplitude() {
        let folder = tempfile::tempdir().unwrap();
        // More depths than one EXR file contains.
        let volume = volume(520);
        let facts = [("sonar:soundSpeed".to_owned(), Attribute::Number(343.25))];
        let at = |name: &str| folder.path().join(name);
        let plain = Encoding { compression: Compression::None, ..Encoding::default() };
        write_volume_npz(&at("a.npz"), &volume, &serde_json::json!({})).unwrap();
        write_volume_exr(&at("a.exr"), &volume, Components::Complex, &facts, Encoding::default()).unwrap();
        write_volume_exr(&at("b.exr"), &volume, Components::Amplitude, &facts, plain).unwrap();
        write_volume_vti(&at("a.vti"), &volume, Components::Complex, &facts).unwrap();
        write_volume_vti(&at("b.vti"), &volume, Components::Amplitude, &facts).unwrap();
        write_volume_nrrd(&at("a.nrrd"), &volume, &facts, Compression::Zip).unwrap();
        write_volume_nrrd(&at("b.nrrd"), &volume, &facts, Compression::None).unwrap();
        let expected = Amplitude::of(&volume).unwrap();
        for name in ["a.npz", "a.exr", "b.exr", "a.vti", "b.vti", "a.nrrd", "b.nrrd"] {
            let found = Amplitude::read(&at(name), 1 << 24).unwrap();
            assert_eq!(found.grid, expected.grid, "{name}");
            assert!(found.values == expected.values, "{name}");
            let refused = Amplitude::read(&at(name), 1000).unwrap_err();
            assert_eq!(refused.exit_status(), 2, "{name}: {refused}");
        }
        assert_eq!(Amplitude::read(Path::new("a.png"), 1).unwrap_err().exit_status(), 2);
    }

    #[test]
    fn half_floats_are_close_to_the_amplitudes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let volume = volume(10);
        let half = Encoding { float16: true, ..Encoding::default() };
        write_volume_exr(&path, &volume, Components::Complex, &[], half).unwrap();
        let found = Amplitude::read(&path, 1 << 20).unwrap();
        for (half, sample) in found.values.iter().zip(&volume.samples) {
            assert!((half - sample.norm()).abs() <= sample.norm() / 2048.0, "{half} {sample}");
        }
        assert!(found.values.iter().zip(&volume.samples).any(|(half, sample)| *half != sample.norm()));
    }

    #[test]
    fn damaged_files_are_refused_and_never_panic() {
        let folder = tempfile::tempdir().unwrap();
        let volume = volume(5);
        let [vti, nrrd, raw] = ["a.vti", "a.nrrd", "b.nrrd"].map(|name| folder.path().join(name));
        write_volume_vti(&vti, &volume, Components::Amplitude, &[]).unwrap();
        write_volume_nrrd(&nrrd, &volume, &[], Compression::Zip).unwrap();
        write_volume_nrrd(&raw, &volume, &[], Compression::None).unwrap();
        for path in [vti, nrrd, raw] {
            let whole = std::fs::read(&path).unwrap();
            for length in 0..whole.len() {
                std::fs::write(&path, &whole[..length]).unwrap();
                // The last lines of a VTI are not read.
                let result = Amplitude::read(&path, 1 << 20);
                assert!(result.is_err() || length + 40 > whole.len(), "{} cut at {length}", path.display());
            }
            for at in 0..whole.len() {
                let mut damaged = whole.clone();
                damaged[at] ^= 0x11;
                std::fs::write(&path, &damaged).unwrap();
                let _ = Amplitude::read(&path, 1 << 20);
            }
        }
    }
}
