//! The positions and labels of an axis' ticks.

/// A tick on an axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    pub(super) label: String,
}

/// The distance between an axis' ticks, and the number of decimals of their labels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    pub(super) length: f64,
    decimals: i32,
}

impl Step {
    /// Ticks within `[low, high]`.
    pub(super) fn count(self, low: f64, high: f64) -> usize {
        let first = (low / self.length - 1e-6).ceil();
        ((high / self.length + 1e-6).floor() - first + 1.0).max(0.0) as usize
    }

    /// The ticks within `[low, high]`; a single one for an interval of zero length.
    pub(super) fn ticks(self, low: f64, high: f64) -> Vec<Tick> {
        if self.length == 0.0 {
            return vec![Tick { value: low, label: label(low, self.decimals) }];
        }
        let first = (low / self.length - 1e-6).ceil();
        (0..self.count(low, high))
            .map(|i| {
                let value = (first + i as f64) * self.length;
                Tick { value, label: label(value, self.decimals) }
            })
            .collect()
    }
}

/// The step for at most `most` ticks (at least 2) at multiples of 1, 2, 2.5 or 5 times a power of ten within
/// `[low, high]`; 0 for an interval of zero length.
pub(super) fn step(low: f64, high: f64, most: usize) -> Step {
    let most = most.max(2);
    let span = high - low;
    if !(span.is_finite() && span > 1e-9 * low.abs().max(high.abs())) {
        return Step { length: 0.0, decimals: 3 };
    }
    let power = (span / most as f64).log10().floor();
    [(1.0, 0), (2.0, 0), (2.5, 1), (5.0, 0), (10.0, -1), (20.0, -1)]
        .into_iter()
        .map(|(factor, more)| Step { length: factor * 10_f64.powf(power), decimals: more - power as i32 })
        .find(|step| step.count(low, high) <= most)
        .unwrap_or(Step { length: span, decimals: 3 })
}

/// At most `most` ticks within `[low, high]`, as [`step`] chooses them.
pub(super) fn ticks(low: f64, high: f64, most: usize) -> Vec<Tick> {
    step(low, high, most).ticks(low, high)
}

/// A number with a fixed number of decimals and a true minus sign, or with an exponent if it is very large or small.
fn label(value: f64, decimals: i32) -> String {
    if decimals > 5 || value.abs() >= 1e6 {
        return scientific(value, 3);
    }
    let text = format!("{value:.*}", decimals.max(0) as usize);
    let is_zero = !text.contains(|c: char| ('1'..='9').contains(&c));
    if is_zero { text.trim_start_matches('-').to_owned() } else { text.replace('-', "−") }
}

/// A number as a product with a power of ten: `7.73 × 10⁻⁴`.
pub(super) fn scientific(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$e}");
    if value == 0.0 {
        return "0".to_owned();
    }
    let Some((factor, power)) = text.split_once('e') else { return text };
    let raised: String = power
        .chars()
        .map(|c| match c {
            '-' => '⁻',
            // The superscripts one, two and three are not next to the others in Unicode.
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            digit => char::from_u32('⁰' as u32 + digit.to_digit(10).unwrap_or(0)).unwrap_or('⁰'),
        })
        .collect();
    format!("{} × 10{raised}", factor.replace('-', "−"))
}

/// The smallest round number that is at least `value`, which must be positive.
pub(super) fn round_up(value: f64) -> f64 {
    let power = 10_f64.powf(value.log10().floor());
    [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0]
        .into_iter()
        .map(|factor| factor * power)
        // A round number in f32 may be slightly above itself.
        .find(|round| *round >= value * (1.0 - 1e-6))
        .unwrap_or(value)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn labels(low: f64, high: f64, most: usize) -> Vec<String> {
        ticks(low, high, most).into_iter().map(|tick| tick.label).collect()
    }

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(labels(0.0, 1.0, 5), ["0.00", "0.25", "0.50", "0.75", "1.00"]);
        assert_eq!(labels(-0.5, 0.5, 7), ["−0.4", "−0.2", "0.0", "0.2", "0.4"]);
        assert_eq!(labels(1.5, 2.5, 6), ["1.6", "1.8", "2.0", "2.2", "2.4"]);
        assert_eq!(labels(-30.0, 0.0, 7), ["−30", "−25", "−20", "−15", "−10", "−5", "0"]);
        assert_eq!(labels(0.0, 255.0, 6), ["0", "50", "100", "150", "200", "250"]);
    }

    #[test]
    fn powers_of_ten_are_raised() {
        assert_eq!(scientific(7.73e-4, 2), "7.73 × 10⁻⁴");
        assert_eq!(scientific(-1.5e23, 1), "−1.5 × 10²³");
        assert_eq!(scientific(0.0, 2), "0");
    }

    #[test]
    fn extreme_intervals_have_few_ticks() {
        for (low, high) in
            [(1.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY), (1e300, 1.1e300), (0.0, 1e-300), (2.0, 1.0)]
        {
            let ticks = ticks(low, high, 6);
            assert!(!ticks.is_empty() && ticks.len() <= 6, "{low} {high}: {ticks:?}");
        }
    }

    #[test]
    fn limits_are_rounded_up() {
        assert_eq!(round_up(3.2), 4.0);
        assert_eq!(round_up(20.0), 20.0);
        assert_eq!(round_up(0.09), 0.1);
    }
}
