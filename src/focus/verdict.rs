//! Whether a curve has found a parameter, or why it has not.

use super::autofocus::FocusTrial;
use crate::choice::choice;

choice! {
    /// What a curve says of a parameter.
    pub enum FocusVerdict: "verdict" {
        /// It has one top, which is sure to a small part of the range.
        Found = "found",
        /// No value of the range would blur the image, so that it cannot tell them apart.
        NoBlur = "no blur",
        /// It is highest at an end of the range.
        EndOfRange = "end of range",
        /// It rises by less than what voxels and the edges of the region change.
        Flat = "flat",
        /// It has several tops of nearly the same height.
        SeveralTops = "several tops",
        /// Parts of the band have tops elsewhere.
        Unsure = "unsure",
    }
}

/// A blur, rms of phases in rad, that takes less than 1 % of the power of a point, is none.
const LEAST_BLUR: f64 = 0.1;

/// A curve that falls by less than this share of its top is flat: overlapping echoes and the edges of the region change up to 2 %,
/// and may move such a top by nearly half of the way to the ends.
const LEAST_CONTRAST: f64 = 0.1;

/// Another top that rises to this share of the highest above the lowest place is a rival.
const RIVAL: f64 = 0.85;

/// The standard error may be this share of the range.
const MOST_ERROR: f64 = 0.1;

/// What is known of a curve when it is judged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Evidence<'a> {
    /// Evenly spaced trials, ascending.
    pub(super) curve: &'a [FocusTrial],
    /// Which of them is the highest.
    pub(super) highest: usize,
    /// rms of phases that an end of the range leaves in a point, rad; the larger of both.
    pub(super) blur: f64,
}

impl Evidence<'_> {
    /// Share by which the curve falls from its top.
    pub(super) fn contrast(&self) -> f64 {
        let top = self.curve[self.highest].measure;
        if top > 0.0 { 1.0 - self.lowest() / top } else { 0.0 }
    }

    fn lowest(&self) -> f64 {
        self.curve.iter().map(|trial| trial.measure).fold(f64::INFINITY, f64::min)
    }

    /// Where the curve crosses the middle of its height on either side of the top, by straight lines between trials; an end of
    /// the range where it does not.
    pub(super) fn width(&self) -> [f64; 2] {
        let level = f64::midpoint(self.curve[self.highest].measure, self.lowest());
        let cross = |inner: FocusTrial, outer: FocusTrial| {
            let part = (inner.measure - level) / (inner.measure - outer.measure);
            inner.value + part * (outer.value - inner.value)
        };
        let mut below = self.curve[..=self.highest].windows(2).rev();
        let mut above = self.curve[self.highest..].windows(2);
        let first = below.find(|pair| pair[0].measure <= level).map(|pair| cross(pair[1], pair[0]));
        let last = above.find(|pair| pair[1].measure <= level).map(|pair| cross(pair[0], pair[1]));
        [first.unwrap_or(self.curve[0].value), last.unwrap_or(self.curve[self.curve.len() - 1].value)]
    }

    /// Another top outside the width, if there is one of nearly the same height.
    fn rival(&self) -> Option<f64> {
        let [first, last] = self.width();
        let top = self.curve[self.highest].measure;
        let level = self.lowest() + RIVAL * (top - self.lowest());
        let outside = |trial: &&FocusTrial| trial.value < first || trial.value > last;
        self.curve.iter().filter(outside).find(|trial| trial.measure >= level).map(|trial| trial.value)
    }

    /// What is wrong with the curve, before its top is looked at closely.
    pub(super) fn objection(&self) -> Option<(FocusVerdict, String)> {
        let contrast = self.contrast();
        if self.blur < LEAST_BLUR {
            let why = format!(
                "at the ends of the range the phases at the microphones differ by {:.3} rad rms from those of a point beside, which \
                 moves the image and does not blur it; a larger array, nearer echoes or a wider range would tell",
                self.blur
            );
            return Some((FocusVerdict::NoBlur, why));
        }
        if contrast < LEAST_CONTRAST {
            let why = format!(
                "the image is sharper by {:.1} % only at the best value than at the worst, which voxels and the edges of the region \
                 change, too; a larger array, nearer echoes or a wider range would tell",
                100.0 * contrast
            );
            return Some((FocusVerdict::Flat, why));
        }
        if self.highest == 0 || self.highest + 1 == self.curve.len() {
            let why = "the image is sharpest at an end of the range; try a range around it".to_owned();
            return Some((FocusVerdict::EndOfRange, why));
        }
        self.rival().map(|value| {
            let why = format!(
                "the image is about as sharp at {value:.6} as at {:.6}; take a smaller range, a region with other echoes, or another \
                 measure",
                self.curve[self.highest].value
            );
            (FocusVerdict::SeveralTops, why)
        })
    }

    /// Whether a top with this standard error is sure; `None`: it has none.
    pub(super) fn of_error(&self, error: Option<f64>) -> Option<(FocusVerdict, String)> {
        let range = self.curve[self.curve.len() - 1].value - self.curve[0].value;
        let why = match error {
            None => "without some part of the band the curve has its top elsewhere, or none".to_owned(),
            Some(error) if error > MOST_ERROR * range => {
                format!(
                    "without some part of the band the top is elsewhere: its standard error is {error:.3}"
                )
            }
            Some(_) => return None,
        };
        Some((FocusVerdict::Unsure, why + "; noise or speckle decide it, not the parameter"))
    }
}
