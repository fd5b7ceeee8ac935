//! The paths with at most one patch, as sequences of mirrors.

use super::PathKind;

/// The kinds of paths with at most one patch, by mirrors before and after it; the direct echo is the first.
///
/// Of `order` 1 those of two surfaces, of 2 those of three as well. The speaker's mirror image, of one surface, is among them:
/// it is the part of the energy that the diffuse echo does not have.
pub(super) fn chains(mirrors: usize, order: u32) -> Vec<PathKind> {
    let of_length: Vec<Vec<Vec<u32>>> = (0..=order + 1).map(|length| sequences(mirrors, length)).collect();
    let mut kinds = Vec::new();
    for bounces in 0..=order as usize {
        for before in (0..=bounces).rev() {
            for first in &of_length[before] {
                for last in &of_length[bounces - before] {
                    let (before, after) = (first.clone(), last.clone());
                    kinds.push(PathKind { before, patches: 1, after, edge: false });
                }
            }
        }
    }
    let alone = of_length[1..].iter().flatten();
    kinds.extend(alone.map(|after| PathKind { after: after.clone(), ..PathKind::default() }));
    kinds
}

/// How many of them have a patch.
pub(super) fn kinds(mirrors: usize, order: u32) -> usize {
    let (one, two) = (mirrors, mirrors * mirrors.saturating_sub(1));
    let once = 1 + 2 * one;
    if order < 2 { once } else { once + 2 * two + one * one }
}

/// All sequences of mirrors, none twice in a row.
fn sequences(mirrors: usize, length: u32) -> Vec<Vec<u32>> {
    let mut all = vec![Vec::new()];
    for _ in 0..length {
        let longer = all.iter().flat_map(|shorter| {
            let differs = |next: &u32| shorter.last() != Some(next);
            (0..mirrors as u32).filter(differs).map(|next| [&shorter[..], &[next]].concat())
        });
        all = longer.collect();
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_is_there_once() {
        for (mirrors, order) in [(0, 1), (1, 1), (3, 1), (3, 2), (4, 2)] {
            let all = chains(mirrors, order);
            let mut seen: Vec<_> = all.iter().map(|k| (&k.before, k.patches, &k.after)).collect();
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len(), all.len());
            assert_eq!(all[0], PathKind { patches: 1, ..PathKind::default() });
            assert_eq!(all.iter().filter(|kind| kind.patches == 1).count(), kinds(mirrors, order));
            let surfaces = |k: &PathKind| k.before.len() + usize::from(k.patches) + k.after.len();
            assert!(all.iter().all(|kind| (1..=order as usize + 1).contains(&surfaces(kind))));
        }
        // Two walls: the direct echo, a mirror before or after, and four paths of mirrors alone.
        assert_eq!(chains(2, 1).len(), 1 + 4 + 4);
        let triple = vec![0, 1, 2];
        assert!(chains(3, 2).iter().any(|kind| kind.patches == 0 && kind.after == triple));
    }
}
