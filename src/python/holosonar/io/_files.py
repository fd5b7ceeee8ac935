"""What all readers share: libraries that are optional, files that are missing or damaged, refusals that name the place."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from .._errors import HolosonarError, InputError, NotFoundError, OutOfMemoryError
from .._run_file import PathLike

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def library(name: str) -> Any:
    """A module of a library that is needed by one format only; the error says how to install it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = {"skrf": "scikit-rf"}.get(name.partition(".")[0], name.partition(".")[0])
        raise ImportError(
            f"{package} is needed to read this format, and cannot be imported: pip install 'holosonar[io]'"
        ) from error


def refusal(place: PathLike, message: str) -> InputError:
    """An error that names the file, and the variable or key in it."""
    name = os.fspath(place)
    error = InputError(f"{name}: {message}")
    error.place = name
    return error


def existing(path: PathLike) -> str:
    """The path as text, if there is such a file."""
    name = os.fspath(path)
    if not os.path.exists(name):
        missing = NotFoundError(f"{name}: no such file; check the path")
        missing.place = name
        raise missing
    return name


@contextmanager
def opened_hdf5(path: PathLike, what: str) -> Iterator[Any]:
    """The root group of an HDF5 file; what cannot be read of it is an InputError that says what was expected."""
    name = existing(path)
    h5py = library("h5py")
    try:
        file = h5py.File(name, "r")
    except OSError as error:
        raise refusal(name, f"cannot be read as HDF5, which {what} is: {error}") from error
    with file:
        try:
            yield file
        except HolosonarError:
            raise
        # h5py raises any of these, depending on where a file is damaged.
        except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
            raise refusal(name, f"is damaged, or not {what}: {error}") from error


def dataset(group: Any, name: str, path: PathLike, what: str) -> Any:
    """A dataset of numbers in a group, not read yet; where there is none, the error lists what there is."""
    found = group.get(name)
    if found is None or not hasattr(found, "dtype"):
        there = ", ".join(sorted(group)) or "nothing"
        raise refusal(path, f"`{name}` is missing, {what}; in {group.name} there is {there}")
    if found.shape is None or found.dtype.kind not in "iufc":
        raise refusal(path, f"`{name}`: numbers were expected, {what}, not {found.dtype}")
    return found


def read_whole(held: Any, path: PathLike) -> NDArray[Any]:
    """A dataset, unless it is more than this machine's memory: a few bytes of HDF5 can declare any size."""
    check_size(held.size * max(held.dtype.itemsize, 8), f"`{held.name.lstrip('/')}`", path)
    whole: NDArray[Any] = held[()]
    return whole


def check_size(n_bytes: int, what: str, path: PathLike) -> None:
    """Refuses what is more than this machine's memory, where the system says how much that is."""
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if 0 < memory < n_bytes:
        name = os.fspath(path)
        error = OutOfMemoryError(
            f"{name}: {what} takes {n_bytes / 2**30:.1f} GiB, and this machine has {memory / 2**30:.1f} GiB; read a part of it"
        )
        error.place = name
        raise error


def numbers(group: Any, name: str, path: PathLike, what: str) -> NDArray[np.float64]:
    """A dataset of real numbers, read."""
    import numpy as np

    held = dataset(group, name, path, what)
    if held.dtype.kind == "c":
        raise refusal(path, f"`{name}`: real numbers were expected, {what}, not {held.dtype}")
    return np.asarray(read_whole(held, path), np.float64)


def subgroup(group: Any, name: str, path: PathLike, what: str) -> Any:
    """A group in a group; where there is none, the error lists what there is."""
    found = group.get(name)
    if found is None or not hasattr(found, "items"):
        there = ", ".join(sorted(group)) or "nothing"
        raise refusal(path, f"`{name}` is missing, {what}; in {group.name} there is {there}")
    return found


def scalar(group: Any, name: str, path: PathLike, what: str) -> float:
    """A single number of a group."""
    held = numbers(group, name, path, what)
    if held.size != 1:
        raise refusal(path, f"`{name}`: one number was expected, {what}, not the shape {list(held.shape)}")
    return float(held.reshape(-1)[0])


def attribute_text(holder: Any, name: str) -> str:
    """An attribute as text, empty where there is none."""
    value = holder.attrs.get(name, "")
    if hasattr(value, "ravel") and getattr(value, "size", 0) == 1:
        value = value.ravel()[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
