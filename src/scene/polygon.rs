//! Cuts faces of more than three corners into triangles.

use glam::{DVec2, DVec3};

/// Above this number of corners no ears are searched for, since the search takes up to `O(n³)`.
const MOST_CORNERS: usize = 1024;

/// How many corners the search for ears in a file's faces may test, so that a file of worst-case faces takes seconds
/// and not hours. A million ordinary faces of ten corners need a tenth of it.
pub(super) const ALLOWANCE: u64 = 1 << 32;

/// The triangles of a face, as indices of its corners, with the winding of the face.
pub(super) struct Triangulation {
    pub(super) triangles: Vec<[usize; 3]>,
    /// The outline crosses itself, is concave with very many corners, or the allowance is used up: the triangles are a
    /// fan from the first corner, which may cover more than the face.
    pub(super) doubtful: bool,
}

/// Cuts a face into triangles: a fan where it is strictly convex, ears otherwise.
///
/// No corner is added, and none is left out where the outline is simple, so faces that share their corners share their
/// edges. Corners on a straight side are included as well. Cost: `O(n)` for a convex face, otherwise up to `O(n³)`,
/// which is deducted from the `allowance`.
pub(super) fn triangulate(corners: &[DVec3], allowance: &mut u64) -> Triangulation {
    let fan =
        |doubtful| Triangulation { triangles: (2..corners.len()).map(|i| [0, i - 1, i]).collect(), doubtful };
    if corners.len() <= 3 {
        return fan(false);
    }
    let flat = flatten(corners);
    let n = flat.len();
    let turns: Vec<f64> = (0..n).map(|i| turn(flat[(i + n - 1) % n], flat[i], flat[(i + 1) % n])).collect();
    if turns.iter().all(|&t| t > 0.0) && winds_once(&flat) {
        return fan(false);
    }
    if n > MOST_CORNERS {
        return fan(true);
    }
    match ears(&flat, allowance) {
        Some(triangles) => Triangulation { triangles, doubtful: false },
        None => fan(true),
    }
}

/// Projects the corners along the axis nearest to the face's normal (Newell's), so that the outline runs
/// counter-clockwise.
fn flatten(corners: &[DVec3]) -> Vec<DVec2> {
    // Differences from the first corner preserve the precision of a small face far from the origin.
    let at = |i: usize| corners[i % corners.len()] - corners[0];
    let normal: DVec3 = (0..corners.len()).map(|i| at(i).cross(at(i + 1))).sum();
    let along = normal.abs().max_position();
    let (x, y) = ((along + 1) % 3, (along + 2) % 3);
    let mirror = if normal[along] < 0.0 { -1.0 } else { 1.0 };
    (0..corners.len()).map(|i| DVec2::new(mirror * at(i)[x], at(i)[y])).collect()
}

/// Twice the signed area of a, b, c: positive for a left turn, zero within rounding of a straight line.
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    let (ab, bc) = (b - a, c - b);
    let turn = ab.perp_dot(bc);
    if turn.abs() <= 1e-12 * ab.length() * bc.length() { 0.0 } else { turn }
}

/// Whether an outline of only left turns winds once; a star winds twice.
fn winds_once(flat: &[DVec2]) -> bool {
    let n = flat.len();
    let angle: f64 = (0..n)
        .map(|i| {
            let (before, after) = (flat[i] - flat[(i + n - 1) % n], flat[(i + 1) % n] - flat[i]);
            before.perp_dot(after).atan2(before.dot(after))
        })
        .sum();
    (angle - std::f64::consts::TAU).abs() < 1.0
}

/// Cuts off one ear after the other: a left turn whose triangle contains no other corner. `None` when there is no
/// ear, which happens only where the outline is not simple, or when the allowance is used up.
fn ears(flat: &[DVec2], allowance: &mut u64) -> Option<Vec<[usize; 3]>> {
    let mut left: Vec<usize> = (0..flat.len()).collect();
    let mut triangles = Vec::with_capacity(flat.len() - 2);
    let mut i = 0;
    let mut since_last_ear = 0;
    while left.len() > 3 {
        let m = left.len();
        *allowance = allowance.checked_sub(m as u64)?;
        let ear = [left[(i + m - 1) % m], left[i % m], left[(i + 1) % m]];
        if is_ear(flat, &left, ear) {
            triangles.push(ear);
            left.remove(i % m);
            since_last_ear = 0;
        } else {
            since_last_ear += 1;
            if since_last_ear > m {
                return None;
            }
        }
        i = (i + 1) % left.len();
    }
    // The last three may be on a straight line, when a corner was on a side; then the previous cut was wrong.
    let last = [left[0], left[1], left[2]];
    (turn(flat[last[0]], flat[last[1]], flat[last[2]]) > 0.0).then(|| {
        triangles.push(last);
        triangles
    })
}

fn is_ear(flat: &[DVec2], left: &[usize], [a, b, c]: [usize; 3]) -> bool {
    let (pa, pb, pc) = (flat[a], flat[b], flat[c]);
    if turn(pa, pb, pc) <= 0.0 {
        return false;
    }
    // Corners on the border count as inside: cutting there would leave one on the new side. A corner at the
    // same place as a, b or c (a slit to a hole) does not matter.
    let inside = |p: DVec2| turn(pa, pb, p) >= 0.0 && turn(pb, pc, p) >= 0.0 && turn(pc, pa, p) >= 0.0;
    left.iter().all(|&k| {
        let p = flat[k];
        p == pa || p == pb || p == pc || !inside(p)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangulate_freely(corners: &[DVec3]) -> Triangulation {
        let mut allowance = ALLOWANCE;
        triangulate(corners, &mut allowance)
    }

    fn area(corners: &[DVec3], cut: &Triangulation) -> f64 {
        let each = cut
            .triangles
            .iter()
            .map(|&[a, b, c]| 0.5 * (corners[b] - corners[a]).cross(corners[c] - corners[a]).dot(DVec3::Z));
        // All wound as the face, none empty.
        assert!(each.clone().all(|a| a > 0.0));
        each.sum()
    }

    fn face(points: &[(f64, f64)]) -> Vec<DVec3> {
        points.iter().map(|&(x, y)| DVec3::new(x, y, 0.25 * x)).collect()
    }

    #[test]
    fn concave_faces_are_covered_once() {
        let l = face(&[(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0)]);
        for shift in 0..l.len() {
            let mut corners = l.clone();
            corners.rotate_left(shift);
            let cut = triangulate_freely(&corners);
            assert!(!cut.doubtful);
            assert!((area(&corners, &cut) - 5.0).abs() < 1e-12);
        }
        let arrow = face(&[(0.0, 0.0), (2.0, 1.0), (0.0, 2.0), (1.0, 1.0)]);
        assert!((area(&arrow, &triangulate_freely(&arrow)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn corners_on_straight_sides_are_kept() {
        let square = face(&[
            (0.0, 0.0),
            (1.0, 0.0),
            (2.0, 0.0),
            (2.0, 1.0),
            (2.0, 2.0),
            (1.0, 2.0),
            (0.0, 2.0),
            (0.0, 1.0),
        ]);
        let cut = triangulate_freely(&square);
        assert_eq!(cut.triangles.len(), 6);
        assert!((area(&square, &cut) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_slit_to_a_hole_is_followed() {
        let ring = face(&[
            (0.0, 0.0),
            (3.0, 0.0),
            (3.0, 3.0),
            (0.0, 3.0),
            (0.0, 0.0),
            (1.0, 1.0),
            (1.0, 2.0),
            (2.0, 2.0),
            (2.0, 1.0),
            (1.0, 1.0),
        ]);
        let cut = triangulate_freely(&ring);
        assert!(!cut.doubtful);
        assert!((area(&ring, &cut) - 8.0).abs() < 1e-12);
    }

    #[test]
    fn outlines_that_cross_themselves_are_doubtful() {
        let bow = face(&[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]);
        let cut_bow = triangulate_freely(&bow);
        assert!(cut_bow.doubtful && cut_bow.triangles.len() == 2);
        let star: Vec<_> = (0..5).map(|k| (f64::from(k) * 0.8 * std::f64::consts::PI).sin_cos()).collect();
        assert!(triangulate_freely(&face(&star)).doubtful);
        assert!(triangulate_freely(&face(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)])).doubtful);
    }

    #[test]
    fn work_is_bounded() {
        let l = face(&[(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0)]);
        let mut allowance = 100;
        assert!(!triangulate(&l, &mut allowance).doubtful);
        assert!(allowance < 100);
        while !triangulate(&l, &mut allowance).doubtful {}
        assert!(!triangulate(&l[..4], &mut allowance).doubtful, "what needs no search is still cut");
    }
}
