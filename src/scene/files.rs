//! Reads a mesh file and the files in its folder, never files elsewhere.

use std::fmt::Display;
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use super::LoadOptions;
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result, gib};
use crate::files::open_input;
use crate::progress::Observer;
use crate::text::quoted;

/// Maximum size of a scene file, bytes.
const LARGEST_FILE: u64 = 4 << 30;

/// A mesh file, or one that it refers to, while it is read.
#[derive(Clone, Copy)]
pub(super) struct MeshFile<'a> {
    pub(super) path: &'a Path,
    pub(super) options: &'a LoadOptions,
    pub(super) observer: &'a dyn Observer,
}

impl MeshFile<'_> {
    /// All its bytes, which must not exceed [`LoadOptions::memory`].
    pub(super) fn read(&self) -> Result<Vec<u8>> {
        read(self.path, self.options.memory)
    }

    /// The error for the file as a whole.
    pub(super) fn refused(&self, problem: impl Into<String>) -> Error {
        Error::input(self.path.display(), problem)
    }

    /// The error for a place in the file, such as "line 3".
    pub(super) fn refused_at(&self, place: impl Display, problem: impl Into<String>) -> Error {
        Error::input(format!("{}, {place}", self.path.display()), problem)
    }

    pub(super) fn warn(&self, message: impl Display) {
        self.observer.warn(&format!("{}: {message}", self.path.display()));
    }

    /// The error for part of the mesh that does not fit in memory.
    pub(super) fn does_not_fit(&self, what: &str) -> Error {
        does_not_fit(self.path.display(), what)
    }

    /// Refuses a sensor for a file without cameras and nodes; `format` reads like "an OBJ".
    pub(super) fn refuse_sensor(&self, format: &str) -> Result<()> {
        if self.options.sensor.is_none() {
            return Ok(());
        }
        let file = self.path.display();
        let problem = format!("needs a glTF file; {file} is {format} file, which has no cameras or nodes");
        Err(Error::input("sensor", problem))
    }
}

/// Why a file with this extension is refused where a mesh was expected, and what to do, where that is known.
pub(crate) fn why_no_mesh(extension: &str) -> Option<&'static str> {
    Some(match extension {
        "step" | "stp" | "iges" | "igs" | "brep" => {
            "holds exact CAD surfaces and no mesh; convert it to .glb, .stl or .obj, as cascadio (for Python) and FreeCAD do"
        }
        "3mf" | "fbx" | "dae" | "blend" | "off" | "x3d" | "usd" | "usdz" => {
            "is of an unsupported format; export it in another one, as Blender does"
        }
        _ => return None,
    })
}

/// At most eight names, for messages.
pub(super) fn list_names<'a>(names: impl IntoIterator<Item = &'a String>) -> String {
    const SHOWN: usize = 8;
    let mut list: Vec<_> =
        names.into_iter().take(SHOWN + 1).map(|name| format!("`{}`", quoted(name))).collect();
    if let Some(last) = list.get_mut(SHOWN) {
        "...".clone_into(last);
    }
    list.join(", ")
}

/// Opens a regular file; returns it and its length in bytes.
pub(super) fn open(path: &Path) -> Result<(File, u64)> {
    let file = open_input(path)?;
    let length = file.metadata().map_err(|error| Error::reading(path, error))?.len();
    if length > LARGEST_FILE {
        return Err(Error::input(path.display(), "is larger than 4 GiB; decimate or split the mesh"));
    }
    Ok((file, length))
}

/// All bytes of a regular file, which must not exceed `memory`.
pub(super) fn read(path: &Path, memory: Option<u64>) -> Result<Vec<u8>> {
    let (file, length) = open(path)?;
    if let Some(limit) = memory.filter(|limit| length > *limit) {
        let problem = format!(
            "is a file of {}, which is read into memory, and {} may be used here (--memory sets another limit); \
             decimate or split the mesh",
            gib(length),
            gib(limit)
        );
        return Err(Error::input(path.display(), problem));
    }
    // The file may have grown since it was measured.
    let mut bytes = try_with_capacity(length).ok_or_else(|| does_not_fit(path.display(), "its bytes"))?;
    file.take(LARGEST_FILE).read_to_end(&mut bytes).map_err(|error| Error::reading(path, error))?;
    Ok(bytes)
}

/// The error for part of a mesh that does not fit in memory.
pub(super) fn does_not_fit(file: impl Display, what: &str) -> Error {
    Error::out_of_memory(format!(
        "{file}: {what} do not fit in memory; decimate the mesh (the acoustic resolution is about 1 cm), or free some \
             memory"
    ))
}

/// The path of the file `relative` inside the folder of `mesh`, or why it is refused. File names in a mesh are not
/// trusted, since the mesh may come from anywhere. A missing file is `Ok`; reading it reports the error.
pub(super) fn beside(mesh: &Path, relative: &str) -> std::result::Result<PathBuf, String> {
    // Exporters on Windows write backslashes.
    let name = relative.replace('\\', "/");
    let harmless = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    let drive = name.as_bytes().get(1) == Some(&b':');
    if name.is_empty() || name.contains('\0') || drive || !Path::new(&name).components().all(harmless) {
        return Err(format!("names `{}`, which is not inside the folder of the file", quoted(relative)));
    }
    let folder = mesh.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let path = folder.join(&name);
    // A symbolic link may lead out of the folder just as `..` does.
    if let (Ok(folder), Ok(real)) = (folder.canonicalize(), path.canonicalize())
        && !real.starts_with(folder)
    {
        return Err(format!("names `{}`, a link that leads out of the folder of the file", quoted(relative)));
    }
    Ok(path)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    #[test]
    fn only_names_inside_the_folder_are_followed() {
        let mesh = Path::new("models/a.gltf");
        assert_eq!(beside(mesh, "sub\\a.bin").unwrap(), Path::new("models/sub/a.bin"));
        assert_eq!(beside(Path::new("a.gltf"), "a b.bin").unwrap(), Path::new("./a b.bin"));
        for outside in
            ["../a.bin", "x/../../a.bin", "/etc/passwd", "C:\\a.bin", "c:a.bin", "", "a\0b", "..\\a.bin"]
        {
            assert_names(beside(mesh, outside).unwrap_err(), &["folder"]);
        }
    }

    #[test]
    #[cfg(unix)]
    fn links_out_of_the_folder_and_endless_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/etc", folder.path().join("out")).unwrap();
        let refused = beside(&folder.path().join("a.gltf"), "out/passwd");
        assert_names(refused.unwrap_err(), &["`out/passwd`", "link"]);
        let refused = |path: &Path| read(path, None).unwrap_err().to_string();
        assert_names(refused(folder.path()), &["folder"]);
        assert_names(refused(Path::new("/dev/zero")), &["/dev/zero", "regular file"]);
        assert_names(refused(&folder.path().join("none.obj")), &["none.obj", "file"]);
    }
}
