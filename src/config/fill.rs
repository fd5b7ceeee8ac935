//! Fills in what follows from what was typed: the array's default pitch, the air, and the third of a grid axis's two
//! ends, pitch and count.

use super::reader::Fault;
use super::tables::ArrayTable;
use super::{GridTable, Layout, MediumTable, RunFile};
use crate::wave::DEFAULT_SOUND_SPEED;

impl RunFile {
    /// Completes what was typed, or says why it cannot be completed.
    pub(super) fn fill(&mut self) -> Result<(), Fault> {
        let array = &mut self.array;
        if array.layout != Layout::File {
            if array.count.is_none() && array.elements.is_none() {
                array.count = Some(ArrayTable::COUNT);
            }
            if array.pitch.is_none() && array.extent.is_none() {
                array.pitch = Some(ArrayTable::PITCH);
            }
        }
        self.medium.fill();
        self.grid.fill()
    }
}

impl MediumTable {
    fn fill(&mut self) {
        if self.temperature.is_some() {
            self.humidity.get_or_insert(Self::HUMIDITY);
            self.pressure.get_or_insert(Self::PRESSURE);
        } else {
            self.sound_speed.get_or_insert(DEFAULT_SOUND_SPEED);
        }
    }
}

impl GridTable {
    fn fill(&mut self) -> Result<(), Fault> {
        let (pitch, count) = (self.pitch, self.count);
        for (axis, (key, ends)) in [("grid.x", &mut self.x), ("grid.y", &mut self.y), ("grid.z", &mut self.z)]
            .into_iter()
            .enumerate()
        {
            let Some([first, last]) = ends else { continue };
            // Reading leaves NaN where only the first voxel was typed.
            if last.is_nan() {
                let (Some(pitch), Some(count)) = (pitch, count) else {
                    return Err(Fault::new(
                        key,
                        "one number is the first voxel alone; expected [first, last], or `pitch` and `count` \
                         beside it",
                    ));
                };
                *last = *first + f64::from(count[axis].saturating_sub(1)) * pitch[axis];
            }
        }
        let (Some(count), None) = (count, pitch) else { return Ok(()) };
        let (Some(x), Some(y), Some(z)) = (self.x, self.y, self.z) else { return Ok(()) };
        let mut pitch = [0.0; 3];
        for (axis, [first, last]) in [x, y, z].into_iter().enumerate() {
            if count[axis] < 2 || last <= first {
                return Err(Fault::new(
                    "grid.count",
                    "the pitch follows from `count` only when each axis has two voxels or more, last after \
                     first; give `pitch` too",
                ));
            }
            pitch[axis] = (last - first) / f64::from(count[axis] - 1);
        }
        self.pitch = Some(pitch);
        Ok(())
    }
}
