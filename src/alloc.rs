//! Fallible allocation of whatever grows with the job.
//!
//! Every function takes a number of values and returns a vector, or `None` where the memory is not there: the caller
//! turns that into an [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) that names what did not fit. Small
//! buffers of a fixed size are allocated the ordinary way.

use bytemuck::Zeroable;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// An empty vector with room for `count` values.
pub(crate) fn try_with_capacity<T>(count: u64) -> Option<Vec<T>> {
    let mut values = Vec::new();
    values.try_reserve_exact(usize::try_from(count).ok()?).ok()?;
    Some(values)
}

/// `count` copies of a value.
pub(crate) fn try_filled<T: Clone>(value: T, count: u64) -> Option<Vec<T>> {
    let mut values = try_with_capacity(count)?;
    values.resize(count as usize, value);
    Some(values)
}

/// `count` zeros. Where the system gives zeroed memory, what nobody writes to takes none.
pub(crate) fn try_zeroed<T: Zeroable>(count: u64) -> Option<Vec<T>> {
    bytemuck::allocation::try_zeroed_vec(usize::try_from(count).ok()?).ok()
}

/// As [`try_zeroed`], for a large part of a job's memory that the next stage needs: it goes back to the system when it is
/// dropped.
///
/// glibc keeps blocks that are smaller than the largest that was freed before, up to 32 MiB, so larger ones are asked for.
pub(crate) fn try_returned<T: Zeroable>(count: u64) -> Option<Vec<T>> {
    const LEAST_BYTES: u64 = 1 << 20;
    const RETURNED_BYTES: u64 = 33 << 20;
    let each = size_of::<T>().max(1) as u64;
    if count < LEAST_BYTES / each {
        return try_zeroed(count);
    }
    let mut values = try_zeroed(count.max(RETURNED_BYTES / each)).or_else(|| try_zeroed(count))?;
    values.truncate(count as usize);
    Some(values)
}

/// Buffers of all threads, as many as are in use at a time, reused by the next that works: memory that is freed and allocated
/// again has to be cleared, and a large one mapped again.
#[derive(Debug)]
pub(crate) struct Reused<T> {
    idle: Mutex<Vec<T>>,
}

impl<T> Reused<T> {
    /// None yet.
    pub(crate) const fn new() -> Self {
        Self { idle: Mutex::new(Vec::new()) }
    }

    /// Works with an idle one, or with another.
    ///
    /// # Errors
    /// Those of `another` and of the work, after which the buffer is dropped.
    pub(crate) fn with<R, E>(
        &self,
        another: impl FnOnce() -> Result<T, E>,
        work: impl FnOnce(&mut T) -> Result<R, E>,
    ) -> Result<R, E> {
        let idle = self.idle().pop();
        let mut buffer = idle.map_or_else(another, Ok)?;
        let result = work(&mut buffer)?;
        self.idle().push(buffer);
        Ok(result)
    }

    fn idle(&self) -> MutexGuard<'_, Vec<T>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex32;

    #[test]
    fn what_does_not_fit_is_none_and_what_fits_is_filled() {
        assert!(try_with_capacity::<u64>(u64::MAX).is_none());
        assert!(try_zeroed::<Complex32>(u64::MAX / 16).is_none());
        assert!(
            try_with_capacity::<u8>(10).is_some_and(|values| values.capacity() >= 10 && values.is_empty())
        );
        assert_eq!(try_filled(3_u8, 4), Some(vec![3; 4]));
        assert_eq!(try_zeroed(2), Some(vec![Complex32::ZERO; 2]));
        assert!(try_returned::<Complex32>(u64::MAX / 16).is_none());
        for count in [3, 1 << 18, 5 << 20] {
            assert!(try_returned::<f32>(count).is_some_and(|values| values == vec![0.0; count as usize]));
        }
    }

    #[test]
    fn buffers_are_made_only_while_all_others_are_in_use() {
        let buffers = Reused::<Vec<u8>>::new();
        let made = |value: u8| move || Ok::<_, ()>(vec![value]);
        let nested = |outer: &mut Vec<u8>| {
            outer.push(7);
            buffers.with(made(2), |inner| Ok((outer.clone(), inner.clone())))
        };
        assert_eq!(buffers.with(made(1), nested), Ok((vec![1, 7], vec![2])));
        let mut left =
            [0, 1].map(|_| buffers.with(|| Err(()), |buffer| Ok(std::mem::take(buffer))).unwrap_or_default());
        left.sort();
        assert_eq!(left, [vec![], vec![1, 7]]);
        assert_eq!(Reused::<u8>::new().with(|| Err(3), |_| Ok(())), Err(3));
    }
}
