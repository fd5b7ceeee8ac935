//! Records: small results, each in a file of its own that is named after the identity of its job.
//!
//! A record is one line of JSON, `{"seal":"…","record":…}`, with the [seal](super::seal) of the bytes of what was recorded, in
//! hexadecimal. It is written under a temporary name and renamed, and never changed, so that processes share a folder of
//! records without locks; two that compute the same job write the same bytes, of which the later stay. Like a journal it has
//! to be a [private] file, and whatever is damaged, of another job or of somebody else is as good as nothing.

use super::Identity;
use super::private::{self, Found, Others};
use super::seal::{Seal, is_equal};
use super::secret::{self, Secret};
use crate::error::{Error, Result};
use crate::files::unfinished::Unfinished;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// What is before the seal, between it and the record, and behind that.
const PARTS: [&str; 3] = ["{\"seal\":\"", "\",\"record\":", "}\n"];

/// Digits of a seal.
const DIGITS: usize = 64;

/// Most bytes of a record's file that are read.
const MOST: u64 = 16 << 20;

/// The end of the name of a record.
const SUFFIX: &str = ".json";

/// A folder of records.
#[derive(Debug)]
pub(crate) struct Records {
    folder: PathBuf,
    secret: Option<Secret>,
}

impl Records {
    /// Those in a folder, which is created with the first.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] where the folder should be is something else.
    pub(crate) fn within(folder: &Path) -> Result<Self> {
        if folder.exists() && !folder.is_dir() {
            return Err(Error::input(
                folder.display(),
                "is a file; a folder of finished combinations was expected",
            ));
        }
        // Without a secret the seal is a checksum, and what protects a record is its owner.
        let secret = secret::folder().and_then(|folder| secret::read_or_create(&folder).ok());
        Ok(Self { folder: folder.to_owned(), secret })
    }

    fn path(&self, identity: &Identity) -> PathBuf {
        self.folder.join(format!("{identity}{SUFFIX}"))
    }

    /// The record of a job, if there is an intact one.
    pub(crate) fn load(&self, identity: &Identity) -> Option<String> {
        let Found::Private(file) = private::open(&self.path(identity), Others::Read) else { return None };
        let mut bytes = Vec::new();
        file.take(MOST).read_to_end(&mut bytes).ok()?;
        unsealed(&bytes, &Seal::new(self.secret, identity)).map(str::to_owned)
    }

    /// Stores the record of a job, which is JSON in one line.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub(crate) fn save(&self, identity: &Identity, record: &str) -> Result<()> {
        let path = self.path(identity);
        let failed = |error| Error::writing(&path, error);
        fs::create_dir_all(&self.folder).map_err(failed)?;
        let mut random = [0; 8];
        getrandom::fill(&mut random).map_err(|error| Error::io(path.display(), error.to_string()))?;
        let random = u64::from_le_bytes(random);
        let unfinished = self.folder.join(format!(".{identity}.{random:016x}.part"));
        let make = || private::create(&unfinished).map(|file| (file, unfinished.clone()));
        let ((mut file, _), listed) = Unfinished::make(make, |(_, path)| path).map_err(failed)?;
        let text = sealed(record, &Seal::new(self.secret, identity));
        let written = file.write_all(text.as_bytes()).and_then(|()| {
            drop::<File>(file);
            fs::rename(&unfinished, &path)
        });
        drop(listed);
        written.map_err(|error| {
            let _ = fs::remove_file(&unfinished);
            failed(error)
        })
    }
}

/// The line of a record.
fn sealed(record: &str, seal: &Seal) -> String {
    let hash = blake3::Hash::from(seal.of(record.as_bytes())).to_hex();
    let [before, between, behind] = PARTS;
    [before, hash.as_str(), between, record, behind].concat()
}

/// The record in a line, if its seal is right.
fn unsealed<'a>(line: &'a [u8], seal: &Seal) -> Option<&'a str> {
    let [before, between, behind] = PARTS.map(str::as_bytes);
    let (digits, rest) = line.strip_prefix(before)?.split_at_checked(DIGITS)?;
    let record = rest.strip_prefix(between)?.strip_suffix(behind)?;
    // As it is written: a digit in upper case is damage, too.
    if digits.iter().any(u8::is_ascii_uppercase) {
        return None;
    }
    let stored = blake3::Hash::from_hex(digits).ok()?;
    let intact = is_equal(&blake3::Hash::from(seal.of(record)), stored.as_bytes());
    std::str::from_utf8(record).ok().filter(|_| intact)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn every_change_of_a_record_is_noticed() {
        let identity = Identity::of("combination");
        let seal = Seal::new(Some([7; 32]), &identity);
        let line = sealed("{\"a\":1.5,\"b\":\"m²\"}", &seal).into_bytes();
        assert_eq!(unsealed(&line, &seal), Some("{\"a\":1.5,\"b\":\"m²\"}"));
        assert!(serde_json::from_slice::<serde_json::Value>(&line).is_ok(), "a line of JSON");
        for at in 0..line.len() {
            for bit in 0..8 {
                let mut changed = line.clone();
                changed[at] ^= 1 << bit;
                assert_eq!(unsealed(&changed, &seal), None, "bit {bit} of byte {at}");
            }
            assert_eq!(unsealed(&line[..at], &seal), None, "cut off at {at}");
        }
        let mut longer = line.clone();
        longer.extend_from_slice(b"}\n");
        assert_eq!(unsealed(&longer, &seal), None);
        assert_eq!(unsealed(&line, &Seal::new(Some([8; 32]), &identity)), None, "another user's");
        assert_eq!(unsealed(&line, &Seal::new(Some([7; 32]), &Identity::of("other"))), None);
    }

    #[test]
    fn a_record_is_loaded_by_its_own_job_and_from_a_private_file_alone() {
        let folder = tempfile::tempdir().unwrap();
        let records = Records { folder: folder.path().join("combinations"), secret: Some([7; 32]) };
        let identity = Identity::of("combination");
        assert_eq!(records.load(&identity), None);
        records.save(&identity, "[1]").unwrap();
        records.save(&identity, "[2]").unwrap();
        assert_eq!(records.load(&identity).as_deref(), Some("[2]"));
        assert_eq!(records.load(&Identity::of("other")), None);
        let path = records.path(&identity);
        assert_eq!(fs::read_dir(&records.folder).unwrap().count(), 1, "nothing unfinished is left");
        // Even under the name of another job's record it is none.
        let other = Identity::of("other");
        fs::copy(&path, records.path(&other)).unwrap();
        assert_eq!(records.load(&other), None);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            fs::set_permissions(&path, fs::Permissions::from_mode(0o666)).unwrap();
            assert_eq!(records.load(&identity), None, "others may have changed it");
            records.save(&identity, "[3]").unwrap();
            assert_eq!(records.load(&identity).as_deref(), Some("[3]"));
            fs::remove_file(&path).unwrap();
            std::os::unix::fs::symlink(records.path(&other), &path).unwrap();
            assert_eq!(records.load(&identity), None, "a link");
        }
        fs::write(folder.path().join("file"), "").unwrap();
        assert!(Records::within(&folder.path().join("file")).is_err());
    }
}
