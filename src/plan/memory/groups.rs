//! The memory that this process's control groups leave it, as systemd, Slurm and containers limit it.
//!
//! `/proc/self/cgroup` names the groups, one for version 2 of the interface and one for each controller of version 1;
//! `/proc/self/mountinfo` says where their files are. A group's ancestors limit it too, up to the root of the mount.

use std::fs;
use std::path::{Path, PathBuf};

/// The files of one version of the interface.
struct Names {
    /// Limits, any of which may be missing or be the word `max`.
    limits: &'static [&'static str],
    used: &'static str,
    /// The line of `memory.stat` for file pages that are freed when memory is needed; with those of the groups below.
    cache: &'static str,
}

/// Version 2. Beyond `memory.high` a process is slowed down until it hardly runs, so it counts as a limit.
const VERSION_2: Names =
    Names { limits: &["memory.max", "memory.high"], used: "memory.current", cache: "inactive_file" };

const VERSION_1: Names =
    Names { limits: &["memory.limit_in_bytes"], used: "memory.usage_in_bytes", cache: "total_inactive_file" };

/// Bytes that the control groups leave; `None` where none has a limit.
pub(super) fn available() -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let mounts = fs::read_to_string("/proc/self/mountinfo").ok()?;
    least(&groups, &mounts, Path::new("/"))
}

/// The same, by the text of both files, of mounts below `root`.
fn least(groups: &str, mounts: &str, root: &Path) -> Option<u64> {
    let mounts: Vec<Mount> = mounts.lines().filter_map(Mount::parse).collect();
    let left = groups.lines().filter_map(|line| {
        let (names, group) = group_of(line)?;
        let of_version = |mount: &&Mount| mount.is_version_2 == (names.used == VERSION_2.used);
        mounts.iter().filter(of_version).filter_map(|mount| mount.least(names, group, root)).min()
    });
    left.min()
}

/// The group in a line of `/proc/self/cgroup`, if it may limit memory.
fn group_of(line: &str) -> Option<(&'static Names, &str)> {
    let (number, rest) = line.split_once(':')?;
    let (controllers, group) = rest.split_once(':')?;
    if number == "0" && controllers.is_empty() {
        return Some((&VERSION_2, group));
    }
    controllers.split(',').any(|name| name == "memory").then_some((&VERSION_1, group))
}

/// A mount of the files of groups.
struct Mount {
    /// The group that is seen at `point`.
    top: String,
    point: String,
    is_version_2: bool,
}

impl Mount {
    /// A line of `/proc/self/mountinfo`, if it is of groups that may limit memory.
    fn parse(line: &str) -> Option<Self> {
        let (place, what) = line.split_once(" - ")?;
        let mut place = place.split(' ').skip(3);
        let (top, point) = (unescaped(place.next()?), unescaped(place.next()?));
        let mut what = what.split(' ');
        let is_version_2 = what.next()? == "cgroup2";
        let controllers = what.nth(1)?;
        let limits =
            is_version_2 || (line.contains(" - cgroup ") && controllers.split(',').any(|c| c == "memory"));
        limits.then_some(Self { top, point, is_version_2 })
    }

    /// The least that a group and its ancestors leave.
    fn least(&self, names: &Names, group: &str, root: &Path) -> Option<u64> {
        let top = root.join(self.point.trim_start_matches('/'));
        // Within a container the group may be named from outside; the mount then begins with it.
        let below = group.strip_prefix(self.top.trim_end_matches('/')).unwrap_or_default();
        let plain = below.split('/').filter(|part| !part.is_empty() && *part != "..");
        let group = plain.fold(top.clone(), |folder: PathBuf, part| folder.join(part));
        let ancestors = group.ancestors().take_while(|folder| folder.starts_with(&top));
        ancestors.filter_map(|folder| names.left(folder)).min()
    }
}

impl Names {
    /// What one group leaves; `None` without a limit.
    fn left(&self, folder: &Path) -> Option<u64> {
        let text = |name: &str| fs::read_to_string(folder.join(name)).ok();
        let number = |name: &str| text(name)?.trim().parse::<u64>().ok();
        let limit = self.limits.iter().filter_map(|name| number(name)).min()?;
        let cache = text("memory.stat").and_then(|stat| {
            stat.lines().find_map(|line| line.strip_prefix(self.cache)?.trim().parse::<u64>().ok())
        });
        Some(limit.saturating_sub(number(self.used)?.saturating_sub(cache.unwrap_or(0))))
    }
}

/// A path as the kernel writes it, with blanks and the like as octal numbers.
fn unescaped(path: &str) -> String {
    [("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")]
        .into_iter()
        .fold(path.to_owned(), |path, (code, character)| path.replace(code, character))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const MOUNTS: &str = "22 1 254:0 / / rw,relatime - ext4 /dev/root rw\n\
         31 23 0:28 / /sys/fs/cgroup rw - tmpfs tmpfs rw,mode=755\n\
         35 31 0:32 / /sys/fs/cgroup/memory rw,relatime shared:9 - cgroup cgroup rw,memory\n\
         36 31 0:33 / /sys/fs/cgroup/cpu rw,relatime - cgroup cgroup rw,cpu\n\
         41 31 0:38 / /sys/fs/cgroup/unified rw,relatime - cgroup2 cgroup2 rw,nsdelegate\n";

    /// Files of groups in a folder of their own.
    fn tree(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            let path = folder.path().join("sys/fs/cgroup").join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, format!("{text}\n")).unwrap();
        }
        folder
    }

    #[test]
    fn the_least_of_nested_groups_counts() {
        // As systemd nests them: the slice leaves less than the service's own limit.
        let folder = tree(&[
            ("unified/user.slice/memory.max", "9000"),
            ("unified/user.slice/memory.current", "4000"),
            ("unified/user.slice/a b.service/memory.max", "max"),
            ("unified/user.slice/a b.service/memory.high", "8000"),
            ("unified/user.slice/a b.service/memory.current", "1000"),
            ("unified/other.slice/memory.max", "1"),
            ("unified/other.slice/memory.current", "0"),
        ]);
        let left = |groups: &str| least(groups, MOUNTS, folder.path());
        assert_eq!(left("4:memory:/\n1:cpu:/\n0::/user.slice/a b.service\n"), Some(5000));
        assert_eq!(left("0::/user.slice\n"), Some(5000));
        assert_eq!(left("0::/\n"), None);
        assert_eq!(left("0::/gone\n"), None);
        assert_eq!(left("not a list of groups"), None);
    }

    #[test]
    fn version_1_counts_too_and_file_pages_that_can_be_freed_do_not() {
        // As Slurm nests them.
        let folder = tree(&[
            ("memory/memory.limit_in_bytes", "9223372036854771712"),
            ("memory/memory.usage_in_bytes", "123456"),
            ("memory/slurm/uid_7/job_5/memory.limit_in_bytes", "5000"),
            ("memory/slurm/uid_7/job_5/memory.usage_in_bytes", "4900"),
            ("memory/slurm/uid_7/job_5/memory.stat", "cache 4100\ninactive_file 1\ntotal_inactive_file 4000"),
            ("memory/slurm/uid_7/job_5/step_0/memory.limit_in_bytes", "4500"),
            ("memory/slurm/uid_7/job_5/step_0/memory.usage_in_bytes", "100"),
            ("cpu/slurm/uid_7/job_5/step_0/memory.limit_in_bytes", "1"),
        ]);
        let left = |groups: &str| least(groups, MOUNTS, folder.path());
        assert_eq!(left("5:cpu:/slurm\n4:pids,memory:/slurm/uid_7/job_5/step_0\n0::/\n"), Some(4100));
        assert!(left("4:memory:/\n").is_some_and(|left| left > 1 << 60));
    }

    #[test]
    fn a_container_sees_its_own_group_at_the_mount() {
        let mounts = "35 31 0:32 /docker/4f /sys/fs/c\\040group ro - cgroup2 cgroup rw\n";
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("sys/fs/c group");
        fs::create_dir_all(own.join("step")).unwrap();
        for (name, text) in [("memory.max", "70"), ("memory.current", "30"), ("step/memory.max", "20")] {
            fs::write(own.join(name), text).unwrap();
        }
        fs::write(own.join("step/memory.current"), "5").unwrap();
        let left = |groups: &str| least(groups, mounts, folder.path());
        assert_eq!(left("0::/docker/4f\n"), Some(40));
        assert_eq!(left("0::/docker/4f/step\n"), Some(15));
        // Of a name that is not below the mount's own, only the mount is known.
        assert_eq!(left("0::/../..\n"), Some(40));
        assert_eq!(left("0::/elsewhere\n"), Some(40));
    }
}
