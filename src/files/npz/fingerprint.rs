//! Identifies the content of a file without reading all of it.

use super::NpzReader;
use crate::error::{Error, Result};

impl NpzReader {
    /// Names, sizes and checksums of everything in the file, one entry per line. Reading an array verifies its checksum.
    ///
    /// # Errors
    /// A damaged directory of the archive.
    pub(crate) fn fingerprint(&mut self) -> Result<String> {
        let mut lines = Vec::new();
        for index in 0..self.archive.len() {
            let entry = self.archive.by_index_raw(index);
            let entry =
                entry.map_err(|error| Error::input(self.path.display(), format!("is damaged ({error})")))?;
            lines.push(format!("{:?} {} {:08x}", entry.name(), entry.size(), entry.crc32()));
        }
        Ok(lines.join("\n"))
    }
}
