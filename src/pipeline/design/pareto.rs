//! Pareto fronts: what no other combination beats in everything that counts.

/// Which of these points are on the front: those than which no other is at least as small in every number and smaller in one.
///
/// Points that are equal do not beat one another. One with a number that is not finite is on no front, and beats none.
///
/// Cost: each point is compared with the front of those before it, in the order of their first numbers.
pub(super) fn front<const N: usize>(points: &[[f64; N]]) -> Vec<bool> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|i| points[*i].iter().all(|number| number.is_finite())).collect();
    // Whoever beats a point comes before it: it is smaller in the first number in which the two differ.
    order.sort_by(|a, b| {
        let pairs = points[*a].iter().zip(&points[*b]);
        pairs.map(|(a, b)| (a + 0.0).total_cmp(&(b + 0.0))).find(|order| order.is_ne()).unwrap_or(a.cmp(b))
    });
    let mut on_it: Vec<usize> = Vec::new();
    for i in order {
        if !on_it.iter().any(|other| beats(&points[*other], &points[i])) {
            on_it.push(i);
        }
    }
    let mut front = vec![false; points.len()];
    for i in on_it {
        front[i] = true;
    }
    front
}

/// Whether `a` is nowhere larger than `b` and somewhere smaller.
fn beats<const N: usize>(a: &[f64; N], b: &[f64; N]) -> bool {
    a.iter().zip(b).all(|(a, b)| a <= b) && a != b
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: f64 = f64::NAN;

    #[test]
    fn fronts_by_hand() {
        assert_eq!(front::<2>(&[]), Vec::<bool>::new());
        assert_eq!(front(&[[3.0, 4.0]]), [true]);
        // A staircase, a point behind it, and one that ties in one number.
        let points = [[1.0, 5.0], [2.0, 3.0], [4.0, 1.0], [3.0, 4.0], [2.0, 4.0], [4.0, 1.5]];
        assert_eq!(front(&points), [true, true, true, false, false, false]);
        // Equal points are both on it, or neither.
        assert_eq!(front(&[[1.0, 1.0], [2.0, 2.0], [1.0, 1.0], [2.0, 2.0]]), [true, false, true, false]);
        assert_eq!(front(&[[0.0, 1.0], [-0.0, 1.0], [0.0, 2.0]]), [true, true, false], "zeros have no sign");
        // What has no error beats nothing, even where it costs nothing.
        assert_eq!(
            front(&[[N, 0.0], [1.0, 1.0], [f64::INFINITY, 0.0], [1.0, N]]),
            [false, true, false, false]
        );
        assert_eq!(front(&[[N, N], [N, 1.0]]), [false, false]);
        // A third number lets more in.
        assert_eq!(front(&[[1.0, 1.0, 9.0], [2.0, 2.0, 1.0], [2.0, 2.0, 9.0]]), [true, true, false]);
    }

    #[test]
    fn a_front_is_what_the_definition_says() {
        let mut state = 1_u64;
        let mut number = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let small = (state >> 33) % 8;
            if small == 7 { N } else { small as f64 }
        };
        for count in 0..60 {
            let points: Vec<[f64; 3]> = (0..count).map(|_| std::array::from_fn(|_| number())).collect();
            let beaten = |p: &[f64; 3]| {
                let better = |q: &[f64; 3]| (0..3).all(|k| q[k] <= p[k]) && (0..3).any(|k| q[k] < p[k]);
                points.iter().any(better)
            };
            let expected: Vec<bool> =
                points.iter().map(|p| p.iter().all(|v| !v.is_nan()) && !beaten(p)).collect();
            assert_eq!(front(&points), expected, "{points:?}");
        }
    }
}
