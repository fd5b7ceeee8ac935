//! The bodies of back-projection's kernels: range profiles about a block's centre, and their sum over its points.
//!
//! About the centre c of a block, one microphone's share of Eq. 13 is `e^{−i2πf_c·δ/c} · Σ_k g_k T_k(δ/H)` with δ the
//! path length less that of the centre, f_c the middle of the band, T_k Chebyshev's polynomials, and H the half-width
//! of the delays that the block has. No sample of a profile is looked up, so nothing has to be gathered.

use super::{LANES, sin_cos_turns, wrap_fast};

/// Points that are worked on at a time: two vectors of 16, so that chains of dependent operations overlap.
const WIDE: usize = 2 * LANES;

/// Coefficients that [`range_profiles_body`] sums at a time, in registers.
const COLUMNS: usize = 4;

/// Points of a block about its centre, in m, padded to whole lanes.
#[derive(Debug, Clone, Default)]
pub struct Points {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// `x² + y² + z²`.
    square: Vec<f32>,
    /// How much longer the way out is to the point than to the centre.
    outward: Vec<f32>,
}

impl Points {
    /// Points as `[x, y, z, outward]`: the offset from the centre, and the outward length less that to the centre, m.
    pub fn new(points: impl ExactSizeIterator<Item = [f64; 4]>) -> Self {
        let padded = points.len().next_multiple_of(WIDE);
        let mut split = Self::default();
        for [x, y, z, outward] in points {
            split.x.push(x as f32);
            split.y.push(y as f32);
            split.z.push(z as f32);
            split.square.push((x * x + y * y + z * z) as f32);
            split.outward.push(outward as f32);
        }
        for all in [&mut split.x, &mut split.y, &mut split.z, &mut split.square, &mut split.outward] {
            all.resize(padded, 0.0);
        }
        split
    }

    /// Number of points, padding included; sums beside them have this length.
    pub fn padded_len(&self) -> usize {
        self.x.len()
    }

    /// Points that `count` are padded to.
    pub fn padded(count: usize) -> usize {
        count.next_multiple_of(WIDE)
    }
}

/// Tones of 16 microphones, `[Q, 16]`.
#[derive(Debug, Clone, Default)]
pub struct LaneTones {
    /// Real parts.
    pub re: Vec<[f32; LANES]>,
    /// Imaginary parts.
    pub im: Vec<[f32; LANES]>,
}

/// Range profiles of 16 microphones about one centre, as coefficients of T_k, `[K, 16]`.
#[derive(Debug, Clone, Default)]
pub struct LaneProfiles {
    /// Real parts.
    pub re: Vec<[f32; LANES]>,
    /// Imaginary parts.
    pub im: Vec<[f32; LANES]>,
}

#[inline(always)]
pub(super) fn range_profiles_body(
    tones: &LaneTones,
    per_metre: &[f64],
    lengths: &[f64; LANES],
    expansion: &[f32],
    profiles: &mut LaneProfiles,
) {
    let count = profiles.re.len();
    assert!(tones.re.len() == per_metre.len() && tones.im.len() == per_metre.len(), "one row per tone");
    assert!(profiles.im.len() == count && count.is_multiple_of(COLUMNS), "coefficients in whole groups");
    assert!(expansion.len() == per_metre.len() * count, "one coefficient per tone and polynomial");
    let LaneProfiles { re: profile_re, im: profile_im } = profiles;
    profile_re.fill([0.0; LANES]);
    profile_im.fill([0.0; LANES]);
    // Tones are turned to the centre in blocks that stay in the first-level cache.
    let mut turned = [[[0.0f32; LANES]; 2]; 32];
    for (((tones_re, tones_im), per_metre), expansion) in tones
        .re
        .chunks(32)
        .zip(tones.im.chunks(32))
        .zip(per_metre.chunks(32))
        .zip(expansion.chunks(32 * count.max(1)))
    {
        for (((re, im), per_metre), turned) in tones_re.iter().zip(tones_im).zip(per_metre).zip(&mut turned) {
            let mut turns = [0.0f32; LANES];
            for l in 0..LANES {
                turns[l] = wrap_fast(lengths[l] * per_metre);
            }
            for l in 0..LANES {
                let (s, c) = sin_cos_turns(turns[l]);
                turned[0][l] = re[l] * c - im[l] * s;
                turned[1][l] = re[l] * s + im[l] * c;
            }
        }
        for first in (0..count).step_by(COLUMNS) {
            let mut sums = [[[0.0f32; LANES]; 2]; COLUMNS];
            for (turned, row) in turned.iter().zip(expansion.chunks_exact(count)) {
                let row: &[f32; COLUMNS] = row[first..first + COLUMNS].try_into().expect("whole groups");
                for k in 0..COLUMNS {
                    for l in 0..LANES {
                        sums[k][0][l] += turned[0][l] * row[k];
                    }
                    for l in 0..LANES {
                        sums[k][1][l] += turned[1][l] * row[k];
                    }
                }
            }
            for k in 0..COLUMNS {
                for l in 0..LANES {
                    profile_re[first + k][l] += sums[k][0][l];
                    profile_im[first + k][l] += sums[k][1][l];
                }
            }
        }
    }
    // The factor (−i)^k that T_k has in the expansion of a tone.
    for k in 0..count {
        for l in 0..LANES {
            let (re, im) = (profile_re[k][l], profile_im[k][l]);
            (profile_re[k][l], profile_im[k][l]) = match k % 4 {
                0 => (re, im),
                1 => (im, -re),
                2 => (-re, -im),
                _ => (-im, re),
            };
        }
    }
}

/// What turns the difference of path lengths into a phase and a place on the profile.
#[derive(Debug, Clone, Copy)]
pub struct RangeScale {
    /// How many times the way to the microphone is travelled.
    pub legs: f32,
    /// f_c/c with the sign of the inverse, −1/m.
    pub carrier: f32,
    /// 1/H, 1/m.
    pub inverse_half: f32,
    /// Coefficients that count, even; those after are zero.
    pub terms: usize,
}

#[inline(always)]
pub(super) fn back_project_body(
    points: &Points,
    offsets: &[[f32; 3]],
    profiles: &LaneProfiles,
    scale: RangeScale,
    sums: [&mut [f32]; 2],
) {
    let [sums_re, sums_im] = sums;
    assert!(offsets.len() <= LANES, "a lane per microphone");
    assert!(scale.terms >= 2 && scale.terms.is_multiple_of(2), "coefficients in pairs");
    let (profile_re, profile_im) = (&profiles.re[..scale.terms], &profiles.im[..scale.terms]);
    assert!(sums_re.len() == points.padded_len() && sums_im.len() == points.padded_len(), "a sum per point");
    for (lane, [x_c, y_c, z_c]) in offsets.iter().enumerate() {
        let centre = (x_c * x_c + y_c * y_c + z_c * z_c).sqrt();
        // Where the centre is the microphone, 0/0 must come out as 0.
        let centre = centre + f32::MIN_POSITIVE;
        let chunks = points.x.as_chunks::<WIDE>().0.iter();
        let chunks = chunks.zip(points.y.as_chunks::<WIDE>().0).zip(points.z.as_chunks::<WIDE>().0);
        let chunks = chunks.zip(points.square.as_chunks::<WIDE>().0);
        let chunks = chunks.zip(points.outward.as_chunks::<WIDE>().0);
        let chunks = chunks.zip(sums_re.as_chunks_mut::<WIDE>().0).zip(sums_im.as_chunks_mut::<WIDE>().0);
        for ((((((x, y), z), square), outward), sum_re), sum_im) in chunks {
            let (mut place, mut turns) = ([0.0f32; WIDE], [0.0f32; WIDE]);
            for l in 0..WIDE {
                // |p − r| − |c − r| without cancellation: (|p − r|² − |c − r|²) / (|p − r| + |c − r|).
                let (px, py, pz) = (x[l] + x_c, y[l] + y_c, z[l] + z_c);
                let length = (px * px + py * py + pz * pz).sqrt();
                let rise = 2.0 * (x[l] * x_c + y[l] * y_c + z[l] * z_c) + square[l];
                let longer = outward[l] + scale.legs * (rise / (length + centre));
                place[l] = longer * scale.inverse_half;
                let cycles = longer * scale.carrier;
                turns[l] = cycles - ((cycles + MAGIC) - MAGIC);
            }
            // Clenshaw's recurrence, two steps at a time so that nothing has to be moved.
            let mut twice = [0.0f32; WIDE];
            let (mut a, mut b) = ([[0.0f32; WIDE]; 2], [[0.0f32; WIDE]; 2]);
            for l in 0..WIDE {
                twice[l] = 2.0 * place[l];
            }
            let pairs = profile_re.as_chunks::<2>().0.iter().zip(profile_im.as_chunks::<2>().0);
            for (re, im) in pairs.skip(1).rev() {
                let (high, low) = ([re[1][lane], im[1][lane]], [re[0][lane], im[0][lane]]);
                for part in 0..2 {
                    for l in 0..WIDE {
                        a[part][l] = twice[l] * b[part][l] - a[part][l] + high[part];
                    }
                    for l in 0..WIDE {
                        b[part][l] = twice[l] * a[part][l] - b[part][l] + low[part];
                    }
                }
            }
            let (high, low) =
                ([profile_re[1][lane], profile_im[1][lane]], [profile_re[0][lane], profile_im[0][lane]]);
            for part in 0..2 {
                for l in 0..WIDE {
                    a[part][l] = twice[l] * b[part][l] - a[part][l] + high[part];
                    b[part][l] = place[l] * a[part][l] - b[part][l] + low[part];
                }
            }
            for l in 0..WIDE {
                let (s, c) = sin_cos_turns(turns[l]);
                sum_re[l] += b[0][l] * c - b[1][l] * s;
                sum_im[l] += b[0][l] * s + b[1][l] * c;
            }
        }
    }
}

/// Adding and subtracting it rounds an f32 to a whole number.
const MAGIC: f32 = 12_582_912.0; // 1.5 · 2^23
