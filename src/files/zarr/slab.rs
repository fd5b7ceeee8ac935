//! Some rows of an array, put together from its chunks.

use super::metadata::ArrayMeta;

/// Some rows of an array along its first axis.
pub(super) struct ArrayRows<'a> {
    meta: &'a ArrayMeta,
    /// The first row, and how many there are.
    pub(super) first: usize,
    rows: usize,
    bytes: Vec<u8>,
}

impl<'a> ArrayRows<'a> {
    /// A slab as high as a chunk; `None` where it does not fit in memory.
    pub(super) fn new(meta: &'a ArrayMeta, rows: usize) -> Option<Self> {
        let rows = rows.min(meta.chunk[0]);
        let mut slab = Self { meta, first: 0, rows, bytes: Vec::new() };
        slab.bytes.try_reserve_exact(slab.row_bytes() * rows).ok()?;
        Some(slab)
    }

    fn row_bytes(&self) -> usize {
        self.meta.shape[1..].iter().product::<usize>() * self.meta.dtype.size as usize
    }

    /// Goes on to the rows from `first` on, at first all missing.
    pub(super) fn begin(&mut self, first: usize, all: usize) {
        (self.first, self.rows) = (first, self.meta.chunk[0].min(all - first));
        self.bytes.clear();
        let elements = self.rows * self.row_bytes() / self.meta.fill.len();
        self.bytes.extend(std::iter::repeat_n(&self.meta.fill, elements).flatten());
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Copies a chunk whose first element is at `origin`, as far as it is within the array.
    pub(super) fn copy(&mut self, chunk: &[u8], origin: &[usize]) {
        let (size, last) = (self.meta.dtype.size as usize, origin.len() - 1);
        let sizes = &self.meta.chunk;
        let within: Vec<usize> = (0..=last)
            .map(|axis| {
                let end = if axis == 0 { self.first + self.rows } else { self.meta.shape[axis] };
                sizes[axis].min(end - origin[axis])
            })
            .collect();
        let run = within[last] * size;
        for at in Odometer::new(&within[..last]) {
            let at = at.into_iter().chain([0]);
            let [mut from, mut to] = [0; 2];
            for (axis, i) in at.enumerate() {
                from = from * sizes[axis] + i;
                let rows_before = if axis == 0 { self.first } else { 0 };
                let length = if axis == 0 { 1 } else { self.meta.shape[axis] };
                to = to * length + origin[axis] + i - rows_before;
            }
            self.bytes[to * size..][..run].copy_from_slice(&chunk[from * size..][..run]);
        }
    }
}

/// All indices below these counts, the last fastest.
pub(super) struct Odometer {
    counts: Vec<usize>,
    next: Option<Vec<usize>>,
}

impl Odometer {
    pub(super) fn new(counts: &[usize]) -> Self {
        let next = counts.iter().all(|&n| n > 0).then(|| vec![0; counts.len()]);
        Self { counts: counts.to_vec(), next }
    }
}

impl Iterator for Odometer {
    type Item = Vec<usize>;

    fn next(&mut self) -> Option<Vec<usize>> {
        let now = self.next.take()?;
        let mut next = now.clone();
        for axis in (0..next.len()).rev() {
            next[axis] += 1;
            if next[axis] < self.counts[axis] {
                self.next = Some(next);
                break;
            }
            next[axis] = 0;
        }
        Some(now)
    }
}
