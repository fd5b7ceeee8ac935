//! What fits in memory, and what is refused because it cannot.

use super::Plan;
use crate::error::{Error, Result};

/// Refuses a job that cannot fit.
///
/// # Errors
/// [`Error::Input`] when the peak exceeds 80 % of the memory that is free, with what would mend it.
pub fn check_memory(plan: &Plan, available: Option<u64>) -> Result<()> {
    let Some(limit) = available.map(usable) else { return Ok(()) };
    if plan.peak_bytes <= limit {
        return Ok(());
    }
    let [n_z, n_y, n_x] = plan.grid_shape;
    Err(Error::input(
        "memory",
        format!(
            "this job needs about {:.1} GiB ({} frequencies x {} microphones: {:.1} GiB; {n_x} x {n_y} x {n_z} voxels: \
             {:.1} GiB), and {:.1} GiB may be used here; make the grid smaller or its pitch larger, or take fewer \
             frequencies or microphones",
            gib(plan.peak_bytes),
            plan.frequencies,
            plan.microphones,
            gib(plan.cube_bytes),
            gib(plan.volume_bytes),
            gib(limit)
        ),
    ))
}

/// Refuses to sample a surface whose points cannot fit: the usual sign of a mesh in the wrong unit.
///
/// # Errors
/// [`Error::Input`] when `bytes` exceed 80 % of the memory that is free.
pub fn check_sampling(bytes: u64, spacing: f64, available: Option<u64>) -> Result<()> {
    match available.map(usable) {
        Some(limit) if bytes > limit => Err(Error::input(
            "reflectors.spacing",
            format!(
                "sampling the scene every {spacing} m needs about {:.1} GiB, and {:.1} GiB may be used here; use a larger \
                 spacing, and check the scene's unit and scale",
                gib(bytes),
                gib(limit)
            ),
        )),
        _ => Ok(()),
    }
}

/// What a job may use of the memory that is free, bytes: 80 %.
pub fn usable(free: u64) -> u64 {
    free / 10 * 8
}

fn gib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 30)
}

/// Memory that is free, bytes, where the system says so.
pub fn available_memory() -> Option<u64> {
    // Linux alone keeps this file; elsewhere allocation itself is the judge.
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampling_that_cannot_fit_is_refused() {
        assert!(check_sampling(1 << 30, 0.01, Some(2 << 30)).is_ok());
        assert!(
            check_sampling(u64::MAX, 0.01, None).is_ok(),
            "where memory is not known, allocation is the judge"
        );
        let error = check_sampling(2 << 30, 0.01, Some(1 << 30)).expect_err("too much").to_string();
        assert!(error.contains("needs about 2.0 GiB"), "{error}");
    }
}
