//! How much of a job is worked on at a time. It changes no byte of the volume, only memory and time.

/// The sizes that memory can be traded against time by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Batch {
    /// Slabs of depths.
    pub(crate) slabs: usize,
    /// Frequencies whose spectra are held, where every one is summed.
    pub(crate) frequencies: usize,
    /// Threads that have buffers of their own.
    pub(crate) workers: usize,
}

impl Batch {
    /// One of each.
    pub(crate) const LEAST: Self = Self { slabs: 1, frequencies: 1, workers: 1 };

    /// Every thread at work on what has no batches.
    pub(crate) fn of_threads(threads: usize) -> Self {
        Self { workers: threads.max(1), ..Self::LEAST }
    }

    /// Half of the slabs and frequencies; when there is one of each, half of the threads.
    fn smaller(self) -> Self {
        let half = |n: usize| (n / 2).max(1);
        if self.slabs > 1 || self.frequencies > 1 {
            Self { slabs: half(self.slabs), frequencies: half(self.frequencies), ..self }
        } else {
            Self { workers: half(self.workers), ..self }
        }
    }

    /// The first of ever smaller batches that takes no more than `memory` bytes, or the least.
    pub(crate) fn within(self, memory: Option<u64>, bytes: impl Fn(Self) -> u64) -> Self {
        let mut batch = self;
        while batch != Self::LEAST && memory.is_some_and(|most| bytes(batch) > most) {
            batch = batch.smaller();
        }
        batch
    }

    /// The least of `items` that one thread is to take at once, so that no more than `workers` take any.
    pub(crate) fn least_run(&self, items: usize) -> usize {
        if self.workers >= rayon::current_num_threads() { 1 } else { items.div_ceil(self.workers).max(1) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_shrink_to_the_memory_there_is_and_threads_go_last() {
        let whole = Batch { slabs: 5, frequencies: 9, workers: 4 };
        let bytes = |batch: Batch| (batch.slabs * 100 + batch.frequencies * 10 + batch.workers) as u64;
        assert_eq!(whole.within(None, bytes), whole);
        assert_eq!(whole.within(Some(594), bytes), whole);
        assert_eq!(whole.within(Some(593), bytes), Batch { slabs: 2, frequencies: 4, workers: 4 });
        assert_eq!(whole.within(Some(113), bytes), Batch { slabs: 1, frequencies: 1, workers: 2 });
        assert_eq!(whole.within(Some(0), bytes), Batch::LEAST);
    }
}
