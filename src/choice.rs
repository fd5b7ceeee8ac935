//! Choices that people type: one word for each variant, the same in run files, on the command line and in reports.
//!
//! [`choice!`] declares such an enumeration with its words, and generates `Display`, `FromStr`, serde's forms and the
//! list of all variants from them, so that each word is in one place.

/// Declares an enumeration of words; `$what` is what an error calls it.
macro_rules! choice {
    (
        $(#[$about:meta])*
        $visible:vis enum $name:ident: $what:literal {
            $($(#[$meaning:meta])* $variant:ident = $word:literal),+ $(,)?
        }
    ) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
        $visible enum $name {
            $($(#[$meaning])* #[serde(rename = $word)] $variant),+
        }

        impl $name {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The word for it in run files, on the command line and in reports.
            pub const fn as_str(self) -> &'static str {
                match self {
                    $(Self::$variant => $word),+
                }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.as_str())
            }
        }

        impl std::str::FromStr for $name {
            type Err = $crate::error::Error;

            /// Reads its word; the error lists the words that exist.
            fn from_str(word: &str) -> $crate::error::Result<Self> {
                Self::ALL
                    .iter()
                    .copied()
                    .find(|choice| choice.as_str() == word)
                    .ok_or_else(|| $crate::choice::unknown($what, word, &[$($word),+]))
            }
        }
    };
}
pub(crate) use choice;

use crate::error::Error;
use crate::text::quoted;

/// The error for a word that is none of `words`.
pub(crate) fn unknown(what: &str, word: &str, words: &[&str]) -> Error {
    Error::input(what, format!("`{}` is not known; expected one of {}", quoted(word), words.join(", ")))
}
