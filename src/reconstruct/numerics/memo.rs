//! The last result of a costly function, for jobs that are planned when their memory is checked and again when they are
//! carried out.

use std::sync::{Mutex, PoisonError};

/// The last argument of a function, and its result.
pub(crate) struct Memo<A, R>(Mutex<Option<(A, R)>>);

impl<A: PartialEq, R: Clone> Memo<A, R> {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(None))
    }

    /// The result for `argument`, as remembered or found.
    pub(crate) fn of(&self, argument: A, find: impl FnOnce() -> R) -> R {
        // Not locked meanwhile: a thread that waits for its own loops may be given another job.
        let last = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, result)) = &*last()
            && *known == argument
        {
            return result.clone();
        }
        let result = find();
        *last() = Some((argument, result.clone()));
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_last_result_is_remembered() {
        let (memo, mut found) = (Memo::new(), Vec::new());
        for argument in [1, 1, 2, 2, 1] {
            assert_eq!(
                memo.of(argument, || {
                    found.push(argument);
                    10 * argument
                }),
                10 * argument
            );
        }
        assert_eq!(found, [1, 2, 1]);
    }
}
