//! A volume's amplitude `|Â|`: every volume format contains it, and pictures need nothing else.

mod reading;

use super::{Attribute, Attributes};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::grid::{Axis, Grid, Volume, no_room_for};
use std::io::Read;
use std::path::Path;

/// `|Â|` on its grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Amplitude {
    /// The positions of the voxels.
    pub grid: Grid,
    /// `|Â|`, without unit, `[z, y, x]`; 1 is a unit reflector.
    pub values: Vec<f32>,
    /// The attributes of the file.
    pub attributes: Attributes,
}

impl Amplitude {
    /// The amplitude of a complex volume.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] if it does not fit in memory.
    pub fn of(volume: &Volume) -> Result<Self> {
        let mut values =
            try_with_capacity(volume.samples.len() as u64).ok_or_else(|| no_room_for(&volume.grid))?;
        values.extend(volume.samples.iter().map(|sample| sample.norm()));
        Ok(Self { grid: volume.grid, values, attributes: Attributes::new() })
    }

    /// Maximum finite value, 0 if there is none.
    pub fn peak(&self) -> f32 {
        self.values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max)
    }
}

/// The grid that a file declares, if its axes are valid and its voxels, of `bytes_each`, are within the limit.
pub(super) fn declared_grid(
    path: &Path,
    first: [f64; 3],
    pitch: [f64; 3],
    count: [usize; 3],
    bytes_each: u64,
    limit_bytes: u64,
) -> Result<Grid> {
    let valid = count.iter().all(|&n| n > 0)
        && first.iter().all(|p| p.is_finite())
        && pitch.iter().all(|p| p.is_finite() && *p > 0.0);
    if !valid {
        return Err(Error::input(
            path.display(),
            format!("declares an invalid grid: {count:?} voxels from {first:?} m at a pitch of {pitch:?} m"),
        ));
    }
    let bytes = count.iter().fold(u128::from(bytes_each), |product, &n| product.saturating_mul(n as u128));
    if bytes > u128::from(limit_bytes) {
        return Err(Error::input(
            path.display(),
            format!("declares {bytes} bytes of voxels, more than the limit of {limit_bytes}"),
        ));
    }
    let [x, y, z] = std::array::from_fn(|i| Axis { first: first[i], pitch: pitch[i], count: count[i] });
    Ok(Grid { x, y, z })
}

/// The three numbers of a vector attribute.
pub(super) fn vector(attributes: &Attributes, name: &str) -> Option<[f64; 3]> {
    match super::find_attribute(attributes, name)? {
        Attribute::Vector(vector) => Some(*vector),
        _ => None,
    }
}

/// Bytes read at a time.
const BLOCK: usize = 1 << 14;

/// Reads the voxels of a grid from little-endian floats; `None` if the file ends early or cannot be read.
///
/// # Errors
/// [`Error::OutOfMemory`] if they do not fit in memory.
pub(super) fn read_floats(file: &mut impl Read, grid: &Grid) -> Result<Option<Vec<f32>>> {
    let count = grid.voxel_count();
    let mut values = try_with_capacity(count).ok_or_else(|| no_room_for(grid))?;
    let mut block = [0; BLOCK];
    while (values.len() as u64) < count {
        let now = (4 * (count - values.len() as u64)).min(BLOCK as u64) as usize;
        if file.read_exact(&mut block[..now]).is_err() {
            return Ok(None);
        }
        values.extend(block[..now].as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)));
    }
    Ok(Some(values))
}
