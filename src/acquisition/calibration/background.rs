//! What is there without the scene.

use super::silence;
use crate::acquisition::cube::check_all_finite;
use crate::acquisition::{CubeFile, DataCube, Instrument};
use crate::error::{Error, Result};
use crate::progress::{Observer, advance};
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use std::path::PathBuf;

/// What is subtracted of the samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Background {
    /// A cube of the same instrument, and the same loudspeakers, without the scene, whose tones may have drifted by up to
    /// 20 % since.
    Cube(PathBuf),
    /// The mean over the microphones, frequency by frequency: leakage that is the same in all of them.
    Mean,
}

impl Background {
    /// Subtracts it and says by how much the power fell.
    pub(super) fn subtract(&self, cube: &mut DataCube, masked: &[bool], memory: u64) -> Result<String> {
        let before = power(&cube.samples);
        let n_mic = masked.len();
        let what = match self {
            Self::Mean => {
                for row in cube.samples.chunks_exact_mut(n_mic) {
                    let mean = mean(row.iter().zip(masked).filter(|(_, masked)| !**masked).map(|(m, _)| m));
                    for m in row {
                        *m -= mean;
                    }
                }
                "the mean over the microphones subtracted".to_owned()
            }
            Self::Cube(path) => {
                let place = path.display();
                let mut empty = CubeFile::open(path, memory)?.load_unchecked()?;
                let differ = |what: &str| {
                    Err(Error::input(
                        place.to_string(),
                        format!(
                            "has other {what} than the cube; a background is measured with the same instrument"
                        ),
                    ))
                };
                let (own, other) = (&cube.instrument, &empty.instrument);
                let near = |a: &f64, b: &f64| (a - b).abs() <= 1e-6 * a.abs();
                let [f, g] = [own, other].map(|i| i.sweep.frequencies());
                if f.len() != g.len() || !f.iter().zip(g).all(|(a, b)| near(a, b)) {
                    return differ("frequencies");
                }
                let [r, s] = [own, other].map(|i| i.array.positions());
                if r.len() != s.len() || !r.iter().zip(s).all(|(a, b)| a.distance(*b) < SAME_PLACE) {
                    return differ("microphones");
                }
                let [s, t] = [own, other].map(Instrument::sources);
                let several = s.len().max(t.len()) > 1;
                if s.len() != t.len()
                    || (several && !s.iter().zip(&t).all(|(a, b)| a.distance(*b) < SAME_PLACE))
                {
                    return differ("loudspeakers");
                }
                if own.detection != other.detection {
                    return differ("samples, in phase or in quadrature,");
                }
                silence(&mut empty, masked, 0.0);
                check_all_finite(&format!("{place}, array `samples`"), &empty.instrument, &empty.samples)?;
                let rows = cube.samples.chunks_exact_mut(n_mic).zip(empty.samples.chunks_exact(n_mic));
                let drift: f64 = rows.map(|(row, empty)| subtract_drifting(row, empty)).sum();
                let drift = 100.0 * (drift / (own.transmissions() * own.sweep.len()) as f64).sqrt();
                format!("background {place} with a drift of {drift:.1} % subtracted")
            }
        };
        Ok(format!("{what}, {}", change(before, power(&cube.samples))))
    }
}

/// Subtracts a tone of the empty room, in the amplitude and phase that fit best; gives the squared relative change of it.
///
/// Speakers and amplifiers drift between two measurements, each tone by its own amount, and what is left of a strong direct
/// wave would lie over the whole range. Echoes resemble the empty room by chance, about as much as one of n microphones'
/// worth; so much of a fit is no drift, and is left out as the James-Stein estimator does.
fn subtract_drifting(row: &mut [Complex32], empty: &[Complex32]) -> f64 {
    let (mut product, mut square, mut whole) = (Complex64::ZERO, 0.0, 0.0);
    for (m, e) in row.iter_mut().zip(empty) {
        *m -= e;
        let [m, e] = [*m, *e].map(|m| Complex64::new(m.re.into(), m.im.into()));
        product += e.conj() * m;
        square += e.norm_sqr();
        whole += m.norm_sqr();
    }
    let fitted = if square > 0.0 { product.norm_sqr() / square } else { 0.0 };
    let chance = BY_CHANCE * (whole - fitted) / (row.len() as f64 - 1.0).max(1.0);
    if fitted <= chance || product.norm() > DRIFT * square {
        return 0.0;
    }
    let drift = product / square * (1.0 - chance / fitted);
    let factor = Complex32::new(drift.re as f32, drift.im as f32);
    row.iter_mut().zip(empty).for_each(|(m, e)| *m -= e * factor);
    drift.norm_sqr()
}

/// A drift must explain this many times the power that it would by chance.
const BY_CHANCE: f64 = 10.0;

/// More is no drift of a background, but echoes that resemble it.
const DRIFT: f64 = 0.2;

/// Distance at which two microphones are the same, m.
const SAME_PLACE: f64 = 1e-4;

/// Subtracts of every microphone the mean of those within half of `diameter`, m, itself among them.
///
/// The lists of neighbours take 4 bytes per pair.
pub(super) fn subtract_neighbours(
    cube: &mut DataCube,
    masked: &[bool],
    diameter: f64,
    observer: &dyn Observer,
) -> Result<String> {
    let before = power(&cube.samples);
    let positions = cube.instrument.array.positions().to_vec();
    let mut neighbours = neighbours(&positions, diameter / 2.0);
    for near in &mut neighbours {
        near.retain(|i| !masked[*i as usize]);
    }
    if neighbours.iter().all(|near| near.len() < 2) {
        let problem =
            format!("is {diameter} m, and no microphones are that near each other; give a larger one");
        return Err(Error::input("[calibration] high_pass", problem));
    }
    let mut old = Vec::new();
    for row in cube.samples.chunks_exact_mut(positions.len()) {
        old.clear();
        old.extend_from_slice(row);
        for (m, near) in row.iter_mut().zip(&neighbours) {
            *m -= mean(near.iter().map(|i| &old[*i as usize]));
        }
        advance(observer, 1)?;
    }
    Ok(format!("the mean within {diameter} m subtracted, {}", change(before, power(&cube.samples))))
}

/// For each point those within `radius`, itself among them, in ascending order.
fn neighbours(points: &[DVec3], radius: f64) -> Vec<Vec<u32>> {
    // By x, so that only a strip is searched.
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let at = |i: &u32| points[*i as usize];
    order.sort_by(|a, b| at(a).x.total_cmp(&at(b).x));
    points
        .iter()
        .map(|p| {
            let first = order.partition_point(|i| at(i).x < p.x - radius);
            let strip = order[first..].iter().take_while(|i| at(i).x <= p.x + radius);
            let mut near: Vec<u32> = strip.filter(|i| at(i).distance(*p) <= radius).copied().collect();
            near.sort_unstable();
            near
        })
        .collect()
}

/// The mean of some samples; 0 of none.
fn mean<'m>(samples: impl Iterator<Item = &'m Complex32>) -> Complex32 {
    let (mut sum, mut n) = (Complex64::ZERO, 0.0_f64);
    for m in samples {
        sum += Complex64::new(m.re.into(), m.im.into());
        n += 1.0;
    }
    let mean = sum / n.max(1.0);
    Complex32::new(mean.re as f32, mean.im as f32)
}

/// Sum of |m|².
pub(super) fn power(samples: &[Complex32]) -> f64 {
    samples.iter().map(|m| f64::from(m.norm_sqr())).sum()
}

/// By how much the power fell or rose.
pub(super) fn change(before: f64, after: f64) -> String {
    if before == 0.0 || after == 0.0 {
        return "nothing is left".to_owned();
    }
    format!("which changes the power by {:+.1} dB", 10.0 * (after / before).log10())
}
