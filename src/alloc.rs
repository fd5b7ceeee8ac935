//! Fallible allocation of whatever grows with the job.
//!
//! Every function takes a number of values and returns a vector, or `None` where the memory is not there: the caller
//! turns that into an [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) that names what did not fit. Small
//! buffers of a fixed size are allocated the ordinary way.

use bytemuck::Zeroable;

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
    }
}
