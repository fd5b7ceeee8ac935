//! The bodies of the phasor kernels for transforms by lanes: a length or a frequency in every lane.

use super::{LANES, Lanes, ROWS, sin_cos_turns, wrap_fast};

#[inline(always)]
pub(super) fn lane_phasors_body<const FMA: bool>(
    cycles_per_metre: &[f64; LANES],
    lengths: &[[f64; LANES]],
    phasors: &mut [Lanes],
) {
    assert!(
        lengths.len() == phasors.len() && lengths.len().is_multiple_of(ROWS),
        "a phasor per length, padded"
    );
    let lengths = lengths.as_chunks::<ROWS>().0;
    for (lengths, phasors) in lengths.iter().zip(phasors.as_chunks_mut::<ROWS>().0) {
        rows_of_phasors::<FMA>(cycles_per_metre, |row, l| lengths[row][l], phasors);
    }
}

/// Phasors for a length in every row and lane.
#[inline(always)]
fn rows_of_phasors<const FMA: bool>(
    cycles_per_metre: &[f64; LANES],
    length: impl Fn(usize, usize) -> f64,
    phasors: &mut [Lanes; ROWS],
) {
    // Two stages, because a loop that mixes f64 and f32 does not vectorise well (4 times slower).
    let mut turns = [[0.0f32; LANES]; ROWS];
    for l in 0..LANES {
        for row in 0..ROWS {
            turns[row][l] = wrap_fast(length(row, l) * cycles_per_metre[l]);
        }
    }
    for l in 0..LANES {
        for row in 0..ROWS {
            (phasors[row].im[l], phasors[row].re[l]) = sin_cos_turns::<FMA>(turns[row][l]);
        }
    }
}

#[inline(always)]
pub(super) fn tone_phasors_body<const FMA: bool>(
    cycles_per_metre: &[f64; LANES],
    squares: &[f64],
    height: f64,
    phasors: &mut [Lanes],
) {
    assert!(
        squares.len() == phasors.len() && squares.len().is_multiple_of(ROWS),
        "a phasor per length, padded"
    );
    for (squares, phasors) in squares.as_chunks::<ROWS>().0.iter().zip(phasors.as_chunks_mut::<ROWS>().0) {
        let lengths = squares.map(|square| (square + height * height).sqrt());
        rows_of_phasors::<FMA>(cycles_per_metre, |row, _| lengths[row], phasors);
    }
}
