//! A plane boundary between two media, parallel to the array: paths that bend there.
//!
//! Sound takes the quickest way (Fermat), which obeys Snell's law at the boundary. Its length is given as that of a straight
//! path of the same duration in the first medium, so that phases, intervals and tones are those of a single medium. It
//! depends on the depths of both ends and on their lateral distance alone: Eq. 16 keeps its form.

use super::Geometry;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A boundary at `depth` beyond which sound has another speed, as of water over metal.
///
/// Nothing is lost or reflected there, and no other wave arises: only paths change.
///
/// # Example
/// Straight down, 10 mm of water and 50 mm of steel:
/// ```
/// use holosonar::glam::DVec3;
/// use holosonar::wave::Interface;
///
/// let steel = Interface { depth: 0.01, sound_speed: 5900.0 };
/// let length = steel.leg_length(1480.0, DVec3::ZERO, DVec3::new(0.0, 0.0, 0.06));
/// assert!((length - (0.01 + 0.05 * 1480.0 / 5900.0)).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interface {
    /// z of the boundary, m; array and loudspeaker are before it.
    pub depth: f64,
    /// Speed of sound beyond it, m/s.
    pub sound_speed: f64,
}

/// What a path does at an interface, apart from where it begins and ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Refraction {
    /// z of the boundary, m.
    depth: f64,
    /// The first medium's speed of sound over that of the second.
    ratio: f64,
    /// By which tabulated lengths may err, m.
    accuracy: f64,
}

/// A leg of a path: its length, and how fast that grows with the lateral distance, the sine of the angle in the first
/// medium.
#[derive(Debug, Clone, Copy)]
struct Leg {
    length: f64,
    sine: f64,
}

impl Interface {
    /// The length of a straight path, in a medium of `sound_speed` m/s, that takes as long as the quickest one from a point
    /// before the interface to any other, m. Cost: some steps of Newton's method, 100 ns.
    pub fn leg_length(&self, sound_speed: f64, from: DVec3, to: DVec3) -> f64 {
        Refraction::new(self, sound_speed, 0.0).leg_length(from, to)
    }

    /// The length of the path speaker → `p` → microphone at `r`, likewise, m.
    pub(crate) fn path_length(&self, sound_speed: f64, geometry: &Geometry, p: DVec3, r: DVec3) -> f64 {
        let back = self.leg_length(sound_speed, r, p);
        match geometry {
            Geometry::Monostatic => 2.0 * back,
            Geometry::FixedSource { .. } | Geometry::Pair { .. } => {
                self.leg_length(sound_speed, geometry.source_of(r), p) + back
            }
        }
    }

    /// The depth at which a point straight ahead would have the same wavefront in the first medium alone: that of its image
    /// to those who look from there.
    pub(crate) fn apparent_depth(&self, sound_speed: f64, z: f64) -> f64 {
        z.min(self.depth) + (z - self.depth).max(0.0) * self.sound_speed / sound_speed
    }
}

impl Refraction {
    /// For a first medium of `sound_speed` m/s, with tables accurate to `accuracy` m.
    pub(crate) fn new(interface: &Interface, sound_speed: f64, accuracy: f64) -> Self {
        Self { depth: interface.depth, ratio: sound_speed / interface.sound_speed, accuracy }
    }

    /// As [`Interface::leg_length`].
    pub(crate) fn leg_length(&self, from: DVec3, to: DVec3) -> f64 {
        self.leg(from.z, to.z, from.truncate().distance(to.truncate())).length
    }

    /// Growth of a leg along z at its end `to`.
    pub(crate) fn slope_along_z(&self, from: DVec3, to: DVec3) -> f64 {
        let leg = self.leg(from.z, to.z, from.truncate().distance(to.truncate()));
        if to.z <= self.depth {
            return (to.z - from.z) / leg.length.max(f64::MIN_POSITIVE);
        }
        // Snell: sin θ₁ = n sin θ₂, and the length grows by n cos θ₂.
        (self.ratio * self.ratio - leg.sine * leg.sine).max(0.0).sqrt()
    }

    /// Bounds on the lengths of paths by way of a box of points: the sums of the shortest and of the longest legs.
    pub(crate) fn path_bounds(
        &self,
        geometry: &Geometry,
        (low, high): (DVec3, DVec3),
        microphones: (DVec3, DVec3),
    ) -> [f64; 2] {
        // A leg grows with the lateral distance, and with the depth on either side of the interface; into a faster medium it is
        // shorter at once, far to the side.
        let crossed = low.z <= self.depth && self.depth < high.z;
        let crossings = [self.depth, self.depth.next_up()].into_iter().filter(|_| crossed);
        let depths: Vec<f64> = [low.z, high.z].into_iter().chain(crossings).collect();
        let legs = |(first, last): (DVec3, DVec3)| {
            let gap = (low - last).max(first - high).max(DVec3::ZERO).truncate();
            let farthest = (high - first).abs().max((last - low).abs()).truncate();
            let nearest = |z: &f64| self.leg_length(last, (last.truncate() + gap).extend(z.max(last.z)));
            let longest = |z: &f64| self.leg_length(first, (first.truncate() + farthest).extend(*z));
            // Points may be behind an array that is moved forward.
            let behind = if low.z < last.z { farthest.length().hypot(last.z - low.z) } else { 0.0 };
            [
                depths.iter().map(nearest).fold(f64::INFINITY, f64::min),
                depths.iter().map(longest).fold(behind, f64::max),
            ]
        };
        let back = legs(microphones);
        let out = match geometry {
            Geometry::FixedSource { source } => legs((*source, *source)),
            Geometry::Monostatic => back,
            Geometry::Pair { offset } => legs((microphones.0 + *offset, microphones.1 + *offset)),
        };
        [out[0] + back[0], out[1] + back[1]]
    }

    /// The height above the array at which a straight path `aside` m to the side would be as steep, or lower.
    pub(crate) fn steepest_height(&self, plane: f64, z: f64, aside: f64) -> f64 {
        let straight_ahead = z.min(self.depth) - plane + (z - self.depth).max(0.0) / self.ratio;
        let sine = self.leg(plane, z, aside).sine;
        if sine <= 0.0 {
            straight_ahead
        } else {
            straight_ahead.min(aside * (1.0 - sine * sine).sqrt() / sine)
        }
    }

    /// The leg between a point at depth `from`, before the interface, and one at depth `to`, `aside` m to the side.
    fn leg(&self, from: f64, to: f64, aside: f64) -> Leg {
        if to <= self.depth {
            let length = aside.hypot(to - from);
            return Leg { length, sine: aside / length.max(f64::MIN_POSITIVE) };
        }
        let (near, far, n) = ((self.depth - from).max(f64::MIN_POSITIVE), to - self.depth, self.ratio);
        // Where it crosses the interface: the slope of the duration is zero there, and grows from −n sin to + sin. In the slower
        // medium no angle is beyond the critical one.
        let critical = |sine: f64| sine / (1.0 - sine * sine).sqrt();
        let mut low = if n > 1.0 { (aside - far * critical(1.0 / n)).max(0.0) } else { 0.0 };
        let mut high = if n < 1.0 { aside.min(near * critical(n)) } else { aside };
        let mut crossing = (aside * near / (near + far / n)).clamp(low, high);
        for _ in 0..MOST_STEPS {
            let (first, second) = (near.hypot(crossing), far.hypot(aside - crossing));
            let slope = crossing / first - n * (aside - crossing) / second;
            let bend = near * near / first.powi(3) + n * far * far / second.powi(3);
            let newton = crossing - slope / bend;
            // What the step would still take from the length.
            if slope * (crossing - newton) <= 1e-16 * (first + n * second) {
                break;
            }
            if slope > 0.0 {
                high = crossing;
            } else {
                low = crossing;
            }
            crossing = if newton > low && newton < high { newton } else { f64::midpoint(low, high) };
        }
        let (first, second) = (near.hypot(crossing), far.hypot(aside - crossing));
        Leg { length: first + n * second, sine: crossing / first }
    }

    /// The legs between points of two depths, by lateral distances up to `farthest` m.
    pub(crate) fn table(&self, from: f64, to: f64, farthest: f64) -> LegTable {
        let mut table = LegTable::new(self, (from, to, farthest), FEWEST);
        while table.legs.len() < MOST && table.error(self, from, to) > self.accuracy {
            table = LegTable::new(self, (from, to, farthest), 2 * table.legs.len());
        }
        table
    }
}

/// Steps after which the bracket has shrunk to rounding, were every one a bisection.
const MOST_STEPS: usize = 60;

/// Intervals of a table.
const FEWEST: usize = 64;
const MOST: usize = 1 << 15;

/// Lengths of legs between two depths, interpolated over the lateral distance by cubics that have their slopes, too.
#[derive(Debug)]
pub(crate) struct LegTable {
    per_metre: f64,
    legs: Vec<Leg>,
}

impl LegTable {
    fn new(refraction: &Refraction, (from, to, farthest): (f64, f64, f64), intervals: usize) -> Self {
        let pitch = farthest.max(f64::MIN_POSITIVE.sqrt()) / (intervals - 1) as f64;
        let leg = |i: usize| {
            let Leg { length, sine } = refraction.leg(from, to, i as f64 * pitch);
            Leg { length, sine: sine * pitch }
        };
        // One more than farthest, so that every place has two neighbours.
        Self { per_metre: 1.0 / pitch, legs: (0..=intervals).map(leg).collect() }
    }

    /// The length for a lateral distance, m, up to the farthest.
    #[inline]
    pub(crate) fn length(&self, aside: f64) -> f64 {
        let place = aside * self.per_metre;
        let i = (place as usize).min(self.legs.len() - 2);
        let (t, [a, b]) = (place - i as f64, [self.legs[i], self.legs[i + 1]]);
        let chord = b.length - a.length;
        let bend = (a.sine - chord) * (1.0 - t) + (chord - b.sine) * t;
        a.length + t * (chord + (1.0 - t) * bend)
    }

    /// The largest error in the middle of an interval, m.
    fn error(&self, refraction: &Refraction, from: f64, to: f64) -> f64 {
        let at = |i: usize| {
            let aside = (i as f64 + 0.5) / self.per_metre;
            (self.length(aside) - refraction.leg(from, to, aside).length).abs()
        };
        (0..self.legs.len() - 2).map(at).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WATER: f64 = 1480.0;

    /// The least duration over all crossings, by golden sections: Fermat's principle as it stands.
    fn least(interface: &Interface, c: f64, from: DVec3, to: DVec3) -> f64 {
        let aside = from.truncate().distance(to.truncate());
        let duration = |x: f64| {
            let (near, far) = (interface.depth - from.z, to.z - interface.depth);
            near.hypot(x) + far.hypot(aside - x) * c / interface.sound_speed
        };
        let (mut low, mut high) = (0.0, aside);
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        for _ in 0..200 {
            let (a, b) = (high - golden * (high - low), low + golden * (high - low));
            if duration(a) < duration(b) { high = b } else { low = a }
        }
        duration(0.5 * (low + high))
    }

    fn pairs() -> impl Iterator<Item = (Interface, DVec3, DVec3)> {
        let fraction = |i: usize, k: f64| (i as f64 * k).fract();
        (0..400).map(move |i| {
            let speed = [343.0, 2300.0, 5900.0, 1500.0][i % 4];
            let depth = [0.01, 0.2, 1e-4][i % 3];
            let place = |k: f64| DVec3::new(fraction(i + 7, k) - 0.5, fraction(i + 3, k * k) - 0.5, 0.0);
            let far = [1e-16, 1e-9, 1e-7, 0.03, 0.4, 2.0][i / 4 % 6] * (0.1 + fraction(i, 0.569_84));
            let beyond = (depth + far).max(depth.next_up());
            let interface = Interface { depth, sound_speed: speed };
            (interface, place(0.618_034).with_z(-0.02 * fraction(i, 0.33)), place(0.754_878).with_z(beyond))
        })
    }

    #[test]
    fn legs_take_the_least_time() {
        for (interface, from, to) in pairs() {
            let (got, expected) = (interface.leg_length(WATER, from, to), least(&interface, WATER, from, to));
            assert!(
                (got - expected).abs() < 1e-12 * (1.0 + expected),
                "{interface:?}: {got}, not {expected}"
            );
        }
    }

    #[test]
    fn the_same_speed_on_both_sides_bends_nothing() {
        let none = Interface { depth: 0.1, sound_speed: WATER };
        for (_, from, to) in pairs() {
            assert!((none.leg_length(WATER, from, to) - from.distance(to)).abs() < 1e-12);
        }
        assert_eq!(none.apparent_depth(WATER, 0.7), 0.1 + 0.6);
    }

    #[test]
    fn slopes_are_those_of_the_length() {
        for (interface, from, to) in pairs().filter(|(i, _, to)| to.z > i.depth + 1e-3) {
            let refraction = Refraction::new(&interface, WATER, 0.0);
            let step = 1e-7;
            let along = |d: DVec3| {
                (refraction.leg_length(from, to + d) - refraction.leg_length(from, to - d)) / (2.0 * step)
            };
            assert!((along(DVec3::Z * step) - refraction.slope_along_z(from, to)).abs() < 1e-5);
            let aside = (to - from).truncate();
            let leg = refraction.leg(from.z, to.z, aside.length());
            let outward = (aside / aside.length()).extend(0.0) * step;
            assert!((along(outward) - leg.sine).abs() < 1e-5);
            // No straight path from that height is less steep anywhere below.
            let height = refraction.steepest_height(from.z, to.z, aside.length());
            for x in (1..50).map(|k| aside.length() * f64::from(k) / 50.0) {
                assert!(refraction.leg(from.z, to.z, x).sine <= x / x.hypot(height) * (1.0 + 1e-6) + 1e-9);
            }
        }
    }

    #[test]
    fn tables_are_as_accurate_as_they_say() {
        for (interface, from, to) in pairs().step_by(5) {
            let (accuracy, farthest) = (1e-9, 1.3);
            let refraction = Refraction::new(&interface, WATER, accuracy);
            let table = refraction.table(from.z, to.z, farthest);
            for aside in (0..=1000).map(|k| farthest * f64::from(k) / 1000.0) {
                let exact = refraction.leg(from.z, to.z, aside).length;
                assert!((table.length(aside) - exact).abs() < 2.0 * accuracy, "{interface:?} {aside}");
            }
        }
        let short =
            Refraction::new(&Interface { depth: 1.0, sound_speed: 1e3 }, 343.0, 1e-9).table(0.0, 2.0, 0.0);
        assert_eq!(short.length(0.0), 1.343);
    }
}
