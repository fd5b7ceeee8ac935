"""The numeric variables of a MATLAB file of any version, in MATLAB's own order of axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._run_file import PathLike
from ._files import attribute_text, existing, library, opened_hdf5, read_whole, refusal

if TYPE_CHECKING:
    from numpy.typing import NDArray


def variables(path: PathLike) -> dict[str, NDArray[Any]]:
    """All numeric arrays of a file by name, fields of structures as ``structure.field``.

    Versions 4 to 7 are read by SciPy, 7.3, which is HDF5, by h5py. There HDF5's axes are MATLAB's reversed, and complex
    numbers are pairs ``real``, ``imag``.

    Raises
    ------
    InputError
        A file that is damaged or none of MATLAB's, or that has no numbers.
    """
    name = existing(path)
    try:
        with open(name, "rb") as file:
            head = file.read(520)
    except OSError as error:
        raise refusal(name, f"cannot be read: {error.strerror}") from error
    found: dict[str, NDArray[Any]] = {}
    if b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:]):
        with opened_hdf5(name, "a MATLAB file of version 7.3") as root:
            _collect_hdf5(root, "", path, found)
    else:
        scipy_io = library("scipy.io")
        try:
            held = scipy_io.loadmat(name)
        except Exception as error:  # SciPy raises whatever a damaged file leads it to.
            raise refusal(name, f"cannot be read as a MATLAB file: {error}") from error
        for key, value in held.items():
            if not key.startswith("__"):
                _collect(value, key, found)
    if not found:
        raise refusal(name, "has no numeric arrays")
    return found


def _collect(value: Any, name: str, found: dict[str, NDArray[Any]]) -> None:
    """Adds an array of SciPy's, or the fields of a structure."""
    names = getattr(getattr(value, "dtype", None), "names", None)
    if names and value.size == 1:
        for field in names:
            _collect(value.reshape(-1)[0][field], f"{name}.{field}", found)
    elif getattr(value, "dtype", None) is not None and value.dtype.kind in "iufc" and value.size:
        found[name] = value


def _collect_hdf5(group: Any, prefix: str, path: PathLike, found: dict[str, NDArray[Any]]) -> None:
    """Adds the arrays of an HDF5 group, and those of groups in it, which are structures."""
    import numpy as np

    for key, item in group.items():
        if key.startswith("#") or attribute_text(item, "MATLAB_class") in ("char", "cell") or "MATLAB_empty" in item.attrs:
            continue
        if hasattr(item, "items"):
            _collect_hdf5(item, f"{prefix}{key}.", path, found)
            continue
        if item.dtype.names == ("real", "imag"):
            pairs = read_whole(item, path)
            value = pairs["real"] + 1j * pairs["imag"]
        elif item.dtype.kind in "iufc" and item.size:
            value = read_whole(item, path)
        else:
            continue
        found[f"{prefix}{key}"] = np.atleast_2d(value).T


def listing(found: dict[str, NDArray[Any]]) -> str:
    """The variables with their types and shapes, as a refusal lists them."""
    return ", ".join(f"{name} ({value.dtype} {list(value.shape)})" for name, value in found.items())
