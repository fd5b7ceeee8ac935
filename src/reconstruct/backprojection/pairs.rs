//! Back-projection of a moved pair: both legs of a path change from microphone to microphone, so that each has points with
//! outward legs of its own, and the profile of one lane.

use super::blocks::Group;
use super::{SlabProfiles, in_sums};
use crate::wave::Geometry;
use crate::wave::simd::{LANES, LaneProfiles, LaneTones, Points, back_project};
use glam::DVec3;

impl SlabProfiles {
    /// As [`SlabProfiles::image`], at `places` along x, y and z, for pairs of these geometries by microphone.
    pub(super) fn image_of_pairs(
        &self,
        centre: DVec3,
        [x, y, z]: &[Vec<f64>; 3],
        geometry_of: impl Fn(usize) -> Geometry,
        groups: &[(&Group, LaneTones)],
        widest: impl Fn(&Group) -> f64,
    ) -> [Vec<f32>; 2] {
        let (mut profiles, mut single) = (LaneProfiles::default(), LaneProfiles::default());
        in_sums(groups, Points::padded(x.len()), |group, tones, sums| {
            let own: Vec<Geometry> = group.members.iter().map(|r| geometry_of(*r)).collect();
            // Lanes without a member are those of the last.
            let lengths = std::array::from_fn(|lane| {
                own[lane.min(own.len() - 1)].path_length(centre, group.positions[lane])
            });
            let scale = self.expand(tones, &lengths, widest(group), &mut profiles);
            for (lane, &r) in group.positions[..group.members.len()].iter().enumerate() {
                first_lane(&profiles.re, lane, &mut single.re);
                first_lane(&profiles.im, lane, &mut single.im);
                let of_pair = Geometry::FixedSource { source: own[lane].source_of(r) };
                let points = Points::about(centre.to_array(), &of_pair, [x, y, z]);
                let [re, im] = &mut *sums;
                back_project(&points, &[(centre - r).as_vec3().to_array()], &single, scale, [re, im]);
            }
        })
    }
}

/// Copies a lane to the first.
fn first_lane(from: &[[f32; LANES]], lane: usize, to: &mut Vec<[f32; LANES]>) {
    to.clear();
    to.extend(from.iter().map(|coefficients| {
        let mut first = [0.0; LANES];
        first[0] = coefficients[lane];
        first
    }));
}
