//! Which slabs of depths share a decomposition.

/// Of which slab each takes the tones: its own, or those of the last before it that found its own, where `share` says so
/// of both B·T and its depths. Slabs are given by B·T and depths.
pub(crate) fn finders(slabs: &[(f64, usize)], share: impl Fn(f64, f64, usize) -> bool) -> Vec<usize> {
    let mut finders: Vec<usize> = Vec::with_capacity(slabs.len());
    for (i, (own, depths)) in slabs.iter().enumerate() {
        let before = finders.last().copied().filter(|&finder| share(slabs[finder].0, *own, *depths));
        finders.push(before.unwrap_or(i));
    }
    finders
}
