//! From `[coding]` to a code.

use crate::acquisition::SourceCode;
use crate::config::RunFile;

impl RunFile {
    /// `[coding]`; `None` where loudspeakers sound one after another.
    pub fn source_code(&self) -> Option<SourceCode> {
        let table = &self.coding;
        let mut code = SourceCode::new(table.kind?);
        code.sequences.clone_from(&table.sequences);
        (code.decoding, code.error) = (table.decoding, table.error);
        // A random stream of its own.
        code.seed = u64::from(table.seed.unwrap_or(1)) ^ 0x636f_6465_0000;
        Some(code)
    }
}
