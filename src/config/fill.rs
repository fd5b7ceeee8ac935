//! Fills in what follows from the keys that were typed: the array's default pitch, the air, and the third of a grid
//! axis's two ends, pitch and count.

use super::range::{Check, ensure};
use super::reader::Fault;
use super::tables::ArrayTable;
use super::{ArrayLayout, GridTable, MediumTable, RunFile, SceneTable};
use crate::wave::DEFAULT_SOUND_SPEED;
use std::collections::{HashMap, HashSet};
use std::path::Path;

impl RunFile {
    /// Completes what was typed, or says why it cannot be completed.
    pub(super) fn fill(&mut self) -> Check {
        let array = &mut self.array;
        if array.layout != ArrayLayout::File {
            if array.elements.is_none() {
                array.count.get_or_insert(ArrayTable::COUNT);
            }
            if array.extent.is_none() {
                array.pitch.get_or_insert(ArrayTable::PITCH);
            }
        }
        self.scene.name_parts();
        self.medium.fill();
        self.grid.fill()
    }
}

impl SceneTable {
    /// Names parts after their files: `cup`, `cup 2`, ...
    fn name_parts(&mut self) {
        let typed: HashSet<String> = self.parts.iter().filter_map(|part| part.name.clone()).collect();
        let mut used: HashMap<String, usize> = HashMap::new();
        for part in &mut self.parts {
            part.name.get_or_insert_with(|| {
                let stem = Path::new(&part.mesh.typed).file_stem().unwrap_or_default().to_string_lossy();
                let count = used.entry(stem.to_string()).or_default();
                loop {
                    *count += 1;
                    let name = if *count == 1 { stem.to_string() } else { format!("{stem} {count}") };
                    if !typed.contains(&name) {
                        return name;
                    }
                }
            });
        }
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
    fn fill(&mut self) -> Check {
        let (pitch, count) = (self.pitch, self.count);
        let axes = [("grid.x", &mut self.x), ("grid.y", &mut self.y), ("grid.z", &mut self.z)];
        for (axis, (key, ends)) in axes.into_iter().enumerate() {
            // Reading leaves NaN where only the first voxel was typed.
            if let Some([first, last]) = ends
                && last.is_nan()
            {
                let (Some(pitch), Some(count)) = (pitch, count) else {
                    let problem = "one number is only the first voxel; expected [first, last], or also `pitch` and `count`";
                    return Err(Fault::new(key, problem));
                };
                *last = *first + f64::from(count[axis].saturating_sub(1)) * pitch[axis];
            }
        }
        let (Some(count), None) = (count, pitch) else { return Ok(()) };
        let (Some(x), Some(y), Some(z)) = (self.x, self.y, self.z) else { return Ok(()) };
        let mut pitch = [0.0; 3];
        for (axis, [first, last]) in [x, y, z].into_iter().enumerate() {
            ensure(count[axis] >= 2 && last > first, || {
                let problem = "the pitch follows from `count` only when each axis has two voxels or more, last after \
                               first; give `pitch` too";
                Fault::new("grid.count", problem)
            })?;
            pitch[axis] = (last - first) / f64::from(count[axis] - 1);
        }
        self.pitch = Some(pitch);
        Ok(())
    }
}
