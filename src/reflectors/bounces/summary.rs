//! Which kinds of bounced echoes are strongest, and where an image shows them.

use super::Reflectors;
use crate::reflectors::bounced::PathKind;
use glam::DVec3;
use serde::Serialize;

/// The echoes of one kind of path.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BouncePath {
    /// What the sound meets, in words.
    pub path: String,
    /// Number of echoes.
    pub echoes: usize,
    /// Their energy relative to that of all direct echoes, dB.
    pub level_db: f64,
    /// The middle of where they are seen, by energy, m.
    pub place: [f64; 3],
    /// The box that has nine tenths of their energy along each axis, its lower and upper corner, m.
    pub within: [[f64; 3]; 2],
}

/// Share of the energy beyond either side of the box.
const TAIL: f64 = 0.05;

impl Reflectors {
    /// The kinds of bounced echoes from the strongest to the weakest, as an array about `centre` shows them that takes all
    /// sound to come straight from the `speaker`, m.
    pub fn bounce_paths(&self, speaker: DVec3, centre: DVec3) -> Vec<BouncePath> {
        let Some(bounced) = &self.bounced else { return Vec::new() };
        let energy = |j: usize| {
            let heard = if bounced.kinds[bounced.kind[j - bounced.first] as usize].edge {
                self.directivity(j, centre)
            } else {
                1.0
            };
            f64::from((self.amplitudes[j] * heard).norm_sqr())
        };
        let direct: f64 = self.amplitudes[..bounced.first].iter().map(|a| f64::from(a.norm_sqr())).sum();
        let mut members = vec![Vec::new(); bounced.kinds.len()];
        for (i, kind) in bounced.kind.iter().enumerate() {
            let j = bounced.first + i;
            let place = apparent_place(self.positions[j], bounced.transmit[i], speaker, centre);
            members[*kind as usize].push((place, energy(j)));
        }
        let known = bounced.kinds.iter().zip(members).filter(|(_, members)| !members.is_empty());
        let name = |kind: &PathKind| {
            let mirror = |facet: &u32| {
                let [x, y, z] = bounced.facets[*facet as usize].centre.to_array();
                format!("mirror `{}` at ({x:.2}, {y:.2}, {z:.2})", bounced.materials[*facet as usize])
            };
            let patches = std::iter::repeat_n("patch".to_owned(), kind.patches.into());
            let met = kind.before.iter().map(mirror).chain(patches).chain(kind.after.iter().map(mirror));
            let met = met.chain(kind.edge.then(|| "edges".to_owned()));
            met.collect::<Vec<_>>().join(", ")
        };
        let mut paths: Vec<BouncePath> = known
            .map(|(kind, members)| {
                let total: f64 = members.iter().map(|(_, energy)| energy).sum();
                let mean = members.iter().map(|(p, energy)| *p * *energy).sum::<DVec3>() / total;
                let ends =
                    [0, 1, 2].map(|axis| quantiles(&members, axis, [TAIL * total, (1.0 - TAIL) * total]));
                BouncePath {
                    path: name(kind),
                    echoes: members.len(),
                    level_db: 10.0 * (total / direct).log10(),
                    place: mean.to_array(),
                    within: [ends.map(|[low, _]| low), ends.map(|[_, high]| high)],
                }
            })
            .collect();
        paths.sort_by(|a, b| b.level_db.total_cmp(&a.level_db));
        paths
    }

    /// Where an array about `centre` shows the strongest bounced echoes, m, at most so many, and their amplitudes.
    pub fn seen_bounces(&self, speaker: DVec3, centre: DVec3, most: usize) -> Vec<(DVec3, f32)> {
        let echoes = self.transmit_lengths().iter().enumerate().map(|(i, &transmit)| {
            let j = self.direct() + i;
            (apparent_place(self.positions[j], transmit, speaker, centre), self.amplitudes[j].norm())
        });
        let mut echoes: Vec<(DVec3, f32)> = echoes.collect();
        // The sort is stable, and so deterministic.
        echoes.sort_by(|a, b| b.1.total_cmp(&a.1));
        echoes.truncate(most);
        echoes
    }
}

/// Where an echo at `place` with a transmit length is seen, m: in its direction from the array's centre, at the distance
/// that a direct echo of the same path has.
fn apparent_place(place: DVec3, transmit: f64, speaker: DVec3, centre: DVec3) -> DVec3 {
    let towards = place - centre;
    let (path, direction, apart) =
        (transmit + towards.length(), towards.normalize_or_zero(), centre - speaker);
    // |centre + ρ u − speaker| + ρ is the path.
    let distance = (path * path - apart.length_squared()) / (2.0 * (path + apart.dot(direction))).max(1e-300);
    centre + direction * distance
}

/// The coordinates below which places have these energies.
fn quantiles<const N: usize>(members: &[(DVec3, f64)], axis: usize, energies: [f64; N]) -> [f64; N] {
    let mut sorted: Vec<(f64, f64)> = members.iter().map(|(p, energy)| (p[axis], *energy)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    energies.map(|energy| {
        let mut below = 0.0;
        let reached = sorted.iter().find(|(_, own)| {
            below += own;
            below >= energy
        });
        reached.or(sorted.last()).map_or(f64::NAN, |(x, _)| *x)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_echo_is_seen_where_a_direct_one_has_its_path() {
        let (speaker, centre) = (DVec3::new(0.3, -0.1, 0.0), DVec3::new(-0.2, 0.1, 0.0));
        let q = DVec3::new(0.4, 0.5, 1.2);
        for transmit in [0.9, 2.5] {
            let seen = apparent_place(q, transmit, speaker, centre);
            let path = transmit + q.distance(centre);
            assert!((seen.distance(speaker) + seen.distance(centre) - path).abs() < 1e-12);
            assert!((seen - centre).normalize().dot((q - centre).normalize()) > 1.0 - 1e-12);
        }
        let own = apparent_place(q, q.distance(speaker), speaker, centre);
        assert!(own.distance(q) < 1e-12, "a direct echo is seen where it is");
    }

    #[test]
    fn ends_are_by_energy() {
        let members: Vec<_> = (0..10).map(|i| (DVec3::X * f64::from(i), 1.0)).collect();
        assert_eq!(quantiles(&members, 0, [0.5, 5.0, 9.5]), [0.0, 4.0, 9.0]);
    }
}
