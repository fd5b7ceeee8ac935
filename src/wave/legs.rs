//! The leg from a reflector to a microphone of a tile: its spreading and its angle, in f32, block by block.

#![allow(clippy::inline_always)]

use super::simd::dispatched;

#[inline(always)]
fn return_legs_body(
    away: [&[f32]; 3],
    microphone: [f32; 3],
    nearest: f32,
    spreading: &mut [f32],
    squares: &mut [f32],
) {
    let [x, y, z] = away;
    let n = spreading.len();
    assert!(x.len() == n && y.len() == n && z.len() == n && squares.len() == n, "planes of equal length");
    let [dx, dy, dz] = microphone;
    for i in 0..n {
        let (x, y, z) = (x[i] - dx, y[i] - dy, z[i] - dz);
        let across = x * x + y * y;
        let square = (across + z * z).max(1e-30);
        spreading[i] = 1.0 / square.sqrt().max(nearest);
        squares[i] = across / square;
    }
}

dispatched! {
    /// `1/|q − d|`, with `|q − d|` of at least `nearest`, and the squared sine of the angle between `q − d` and z, for
    /// reflectors at `q = away` (m, three planes) and a microphone at `d`, both from the tile's centre.
    ///
    /// Cost: about 15 operations. The error is a few 10⁻⁷ where `|q − d|` is not much smaller than `|q|`.
    ///
    /// # Panics
    /// When the planes differ in length.
    pub(crate) fn return_legs = return_legs_body(
        away: [&[f32]; 3], microphone: [f32; 3], nearest: f32, spreading: &mut [f32], squares: &mut [f32],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn legs_are_lengths_and_angles() {
        let fraction = |i: usize, k: f64| (i as f64 * k).fract() - 0.5;
        let q: Vec<DVec3> = (0..99)
            .map(|i| DVec3::new(fraction(i, 0.618_034), fraction(i, 0.754_878), 0.2 + fraction(i, 0.569_84)))
            .collect();
        let plane = |axis: usize| q.iter().map(|q| q[axis] as f32).collect::<Vec<f32>>();
        let planes = [plane(0), plane(1), plane(2)];
        let away = [&planes[0][..], &planes[1], &planes[2]];
        let d = DVec3::new(0.03, -0.02, 0.01);
        let (mut spreading, mut squares) = (vec![0.0; 99], vec![0.0; 99]);
        return_legs(away, d.as_vec3().to_array(), 0.3, &mut spreading, &mut squares);
        let (mut plain, mut angles) = (vec![0.0; 99], vec![0.0; 99]);
        return_legs_body(away, d.as_vec3().to_array(), 0.3, &mut plain, &mut angles);
        assert_eq!(
            (&spreading, &squares),
            (&plain, &angles),
            "every instruction set gives bit-identical results"
        );
        for (i, q) in q.iter().enumerate() {
            let leg = *q - d;
            assert!((f64::from(spreading[i]) * leg.length().max(0.3) - 1.0).abs() < 1e-6);
            let sine = leg.x.hypot(leg.y) / leg.length();
            assert!((f64::from(squares[i]) - sine * sine).abs() < 1e-6);
        }
    }
}
