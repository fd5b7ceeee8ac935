//! Which instruction set the kernels take.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicU8, Ordering};

/// An instruction set that the kernels are compiled for, in ascending order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// What every processor of the kind has that this program was built for.
    Baseline,
    /// AVX2 and FMA.
    Avx2,
    /// AVX-512 F, DQ, VL and BW.
    Avx512,
}

impl Level {
    /// Every level, in ascending order.
    pub const ALL: [Self; 3] = [Self::Baseline, Self::Avx2, Self::Avx512];

    /// The name in lower case, as it is typed.
    pub fn name(self) -> &'static str {
        match self {
            Self::Baseline => "baseline",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

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

    /// The level of this name, for a processor whose highest is `most`; `place` is what named it, for the message.
    ///
    /// # Errors
    /// [`Error::Input`]: no such level, or one above `most`.
    pub fn named(place: &str, name: &str, most: Self) -> Result<Self> {
        let had = Self::ALL.map(Self::name)[..=most as usize].join(", ");
        let Some(level) = Self::ALL.into_iter().find(|level| level.name() == name) else {
            return Err(Error::input(
                place,
                format!("`{name}` is no instruction set of this program; this processor has {had}"),
            ));
        };
        if level > most {
            return Err(Error::input(
                place,
                format!("this processor does not have {name}; it has {had}, and takes the last unless told"),
            ));
        }
        Ok(level)
    }
}

/// The highest level that may be taken.
static LIMIT: AtomicU8 = AtomicU8::new(Level::Avx512 as u8);

/// Lets every kernel of this process take at most this level from now on. It changes no byte of a result.
pub fn limit(level: Level) {
    LIMIT.store(level as u8, Ordering::Relaxed);
}

/// The level that the kernels take: the processor's highest, up to the [`limit`].
#[inline]
pub fn level() -> Level {
    Level::of_processor().min(Level::ALL[usize::from(LIMIT.load(Ordering::Relaxed))])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    #[test]
    fn a_level_is_named_and_had() {
        for level in Level::ALL {
            assert_eq!(Level::named("here", level.name(), Level::Avx512), Ok(level));
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
