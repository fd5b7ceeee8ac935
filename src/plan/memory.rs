//! How much memory a job may use.

mod groups;

/// The most bytes that a job may use: those requested, else 80 % of the free memory, where the system reports it; but
/// no more than this process's address space (`ulimit -v`).
pub(crate) fn memory_limit(asked: Option<u64>) -> Option<u64> {
    let most = asked.or_else(|| available_memory().map(|free| free / 10 * 8));
    [most, address_space()].into_iter().flatten().min()
}

/// What is left of this process's address space.
pub(crate) fn address_space() -> Option<u64> {
    let limit = soft_limit(&std::fs::read_to_string("/proc/self/limits").ok()?)?;
    // Takes the system a while to write, and mostly there is no limit.
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    Some(limit.saturating_sub(used_addresses(&status)?))
}

/// The soft limit in the text of `/proc/self/limits`; `None` when there is none.
fn soft_limit(limits: &str) -> Option<u64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// The address space that a process uses, by the text of `/proc/self/status`.
fn used_addresses(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmSize:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

/// Memory that is free, bytes: the least of the system's and that of the control groups, where there are such.
fn available_memory() -> Option<u64> {
    [system_memory(), groups::available()].into_iter().flatten().min()
}

/// What the system has left.
fn system_memory() -> Option<u64> {
    // Only Linux has this file; elsewhere an allocation that fails is reported.
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_of_addresses_is_read() {
        let limits = "Limit                     Soft Limit           Hard Limit           Units     \n\
                      Max address space         1073741824           unlimited            bytes     \n";
        assert_eq!(soft_limit(limits), Some(1 << 30));
        assert_eq!(soft_limit(&limits.replace("1073741824", "unlimited")), None);
        assert_eq!(used_addresses("Name:\tx\nVmSize:\t   12 kB\n"), Some(12 << 10));
    }
}
