//! Choices that people type: one word for each variant, the same in run files, on the command line and in reports.
//!
//! [`choice!`] declares such an enumeration with its words, and makes of them `Display`, `FromStr`, serde's forms and the
//! list of all, so that a word stands in one place.

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
            /// Every one of them.
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

            /// Reads its word; the error names the words there are.
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

/// The refusal of a word that is none of `words`.
pub(crate) fn unknown(what: &str, word: &str, words: &[&str]) -> Error {
    Error::input(
        what,
        format!("`{}` is not known; expected one of {}", word.escape_debug(), words.join(", ")),
    )
}

#[cfg(test)]
mod tests {
    use crate::acquisition::{Detection, PropagationModel};
    use crate::depth::{Pick, Refine};
    use crate::error::{Error, ErrorKind};
    use crate::reconstruct::{Method, Window};
    use crate::scene::{Unit, Up};
    use crate::wave::GeometryKind;
    use crate::wave::simd::Level;
    use serde::{Deserialize, Serialize};
    use std::fmt::{Debug, Display};
    use std::str::FromStr;

    fn words_go_there_and_back<T>(all: &[T])
    where
        T: Debug + Display + Serialize + for<'de> Deserialize<'de> + FromStr<Err = Error> + PartialEq + Copy,
    {
        for choice in all {
            let word = choice.to_string();
            assert_eq!(word.parse::<T>().as_ref(), Ok(choice));
            assert_eq!(serde_json::to_value(choice).expect("a word"), serde_json::json!(word));
            assert_eq!(serde_json::from_value::<T>(serde_json::json!(word)).expect("known"), *choice);
        }
        for wrong in ["", "Auto", "no such word"] {
            let error = wrong.parse::<T>().expect_err("unknown");
            assert_eq!(error.kind(), ErrorKind::InvalidInput);
            for choice in all {
                assert!(error.to_string().contains(&choice.to_string()), "{error}: {choice}");
            }
        }
    }

    #[test]
    fn every_choice_is_read_and_shown_alike() {
        words_go_there_and_back(Method::ALL);
        words_go_there_and_back(Window::ALL);
        words_go_there_and_back(Detection::ALL);
        words_go_there_and_back(PropagationModel::ALL);
        words_go_there_and_back(GeometryKind::ALL);
        words_go_there_and_back(Pick::ALL);
        words_go_there_and_back(Refine::ALL);
        words_go_there_and_back(Unit::ALL);
        words_go_there_and_back(Up::ALL);
        words_go_there_and_back(Level::ALL);
        assert_eq!(format!("[{:>14}]", Method::Convolution), "[   convolution]", "it can be aligned");
    }
}
