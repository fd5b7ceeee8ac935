//! What tells a file's content from any other's without reading it.

use super::NpzReader;
use crate::error::{Error, Result};

impl NpzReader {
    /// Names, sizes and checksums of everything in the file, one on a line. Reading an array proves its checksum right.
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
