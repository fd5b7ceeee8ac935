//! The instruction set that the kernels use.

use crate::choice::choice;
use crate::error::{Error, Result};
use std::sync::atomic::{AtomicU8, Ordering};

choice! {
    /// An instruction set that the kernels are compiled for, in ascending order.
    #[derive(PartialOrd, Ord)]
    pub enum Level: "instruction set" {
        /// The instructions of every processor of the target architecture; on x86, fused multiply-add is worked out in f64,
        /// which takes ten times as long.
        Baseline = "baseline",
        /// AVX2 and FMA.
        Avx2 = "avx2",
        /// AVX-512 F, DQ, VL and BW.
        Avx512 = "avx512",
    }
}

impl Level {
    /// The highest level of this processor.
    pub fn of_processor() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            let wide = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512bw");
            return if wide { Self::Avx512 } else { Self::Avx2 };
        }
        Self::Baseline
    }

    /// The level of this name, for a processor whose highest is `most`; `place` is where the name was given, for the message.
    ///
    /// # Errors
    /// [`Error::InvalidInput`]: no such level, or one above `most`.
    pub(crate) fn named(place: &str, name: &str, most: Self) -> Result<Self> {
        let level: Self = name.parse().map_err(|error: Error| error.at(place))?;
        if level > most {
            let supported = Self::ALL[..=most as usize].iter().map(|level| level.as_str());
            let supported = supported.collect::<Vec<_>>().join(", ");
            let problem = format!(
                "this processor does not support {name}; it supports {supported}, and uses the last by default"
            );
            return Err(Error::input(place, problem));
        }
        Ok(level)
    }
}

/// The highest level that may be used.
static LIMIT: AtomicU8 = AtomicU8::new(Level::Avx512 as u8);

/// Limits every kernel of this process to this level from now on. Results are bit-identical at every level; a level that
/// the processor does not support is never used.
///
/// This is the library's only setting for a whole process. The instruction set is a property of the computer, which the
/// kernels detect themselves, and no result depends on it. As an argument it would pass through every function of every
/// stage, and only tests that compare the levels and processors that reduce their clock rate for wide registers need it. The library reads no environment variable; the command line sets this from `HOLOSONAR_SIMD`.
///
/// ```
/// use holosonar::wave::simd::{Level, level, limit};
///
/// limit(Level::Baseline);
/// assert_eq!(level(), Level::Baseline);
/// limit(Level::Avx512);
/// assert_eq!(level(), Level::of_processor());
/// ```
pub fn limit(level: Level) {
    LIMIT.store(level as u8, Ordering::Relaxed);
}

/// The level that the kernels use: the processor's highest, up to the [`limit`].
#[inline]
pub fn level() -> Level {
    Level::of_processor().min(Level::ALL[usize::from(LIMIT.load(Ordering::Relaxed))])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    #[test]
    fn levels_are_parsed_and_limited_to_the_processor() {
        for level in Level::ALL.iter().copied() {
            assert_eq!(Level::named("here", level.as_str(), Level::Avx512), Ok(level));
            assert_eq!(Level::ALL[level as usize], level, "in ascending order");
        }
        let said = |name, most| Level::named("here", name, most).expect_err("refused").to_string();
        assert_names(said("avx512", Level::Avx2), &["here", "avx512", "baseline, avx2"]);
        assert_names(said("avx2", Level::Baseline), &["here", "avx2", "baseline"]);
        for unknown in ["", "AVX2", "sse", "avx 2"] {
            assert_names(said(unknown, Level::Avx2), &["here", &format!("`{unknown}`"), "baseline, avx2"]);
        }
    }
}
