"""Run files, and settings of their keys."""

from __future__ import annotations

import json
import math
import numbers
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Union

from . import _holosonar

#: A path of a file.
PathLike = Union[str, "os.PathLike[str]"]

#: Settings of run-file keys: ``{"sweep.step": 40, "reconstruct.window": "hann"}``, or as they are typed after ``--set``:
#: ``["sweep.step=40"]``.
Settings = Union[Mapping[str, Any], Iterable[str], None]


def _toml(value: Any) -> str:
    """A value of Python as TOML."""
    if isinstance(value, (bool,)) or type(value).__name__ in ("bool_", "bool"):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, os.PathLike):
        return _toml(os.path.abspath(os.fspath(value)))
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        number = float(value)
        if math.isnan(number):
            return "nan"
        return repr(number) if math.isfinite(number) else ("inf" if number > 0 else "-inf")
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Iterable):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    raise TypeError(f"a setting was expected to be a number, a word, a truth value or a list of them, not {value!r}")


def typed(settings: Settings, **further: Any) -> list[str]:
    """Settings as they are typed after ``--set``; ``further`` are ``table__key=value``, left out where ``None``."""
    if settings is None:
        listed = []
    elif isinstance(settings, str):
        listed = [settings]
    elif isinstance(settings, Mapping):
        listed = [f"{key}={_toml(value)}" for key, value in settings.items()]
    else:
        listed = [str(setting) for setting in settings]
    named = {key.replace("__", "."): value for key, value in further.items() if value is not None}
    return listed + [f"{key}={_toml(value)}" for key, value in named.items()]


class RunFile:
    """A run file: every option of a job, checked, with all defaults.

    Parameters
    ----------
    path : path, optional
        A run file (.toml), a mesh (.obj, .gltf, .glb, .stl, .ply) or a list of reflectors (.csv). A mesh is placed before
        an array that suits its size. Without a path, the defaults.
    set : mapping or list of str, optional
        Keys to set: ``{"sweep.step": 40}`` or ``["sweep.step=40"]``. Files are relative to that of the run file.

    Raises
    ------
    InputError
        A key or a value that is not known, or not possible; the message names the line.
    NotFoundError
        A file that is missing.

    Examples
    --------
    >>> run = RunFile("scenes/corner.toml", set={"sweep.step": 40})  # doctest: +SKIP
    >>> run["sweep.step"]  # doctest: +SKIP
    40.0
    """

    __slots__ = ("_run",)

    def __init__(self, path: PathLike | None = None, *, set: Settings = None) -> None:
        if path is None:
            self._run = _holosonar.RunFile.from_toml("", "", typed(set))
        else:
            self._run = _holosonar.RunFile.load(os.fspath(path), typed(set))

    @classmethod
    def from_toml(cls, text: str, *, folder: PathLike = "", set: Settings = None) -> RunFile:
        """A run file from its text.

        Parameters
        ----------
        text : str
            TOML.
        folder : path
            Files that the text names are relative to it.
        set : mapping or list of str, optional
            Keys to set.
        """
        run = cls.__new__(cls)
        run._run = _holosonar.RunFile.from_toml(text, os.fspath(folder), typed(set))
        return run

    def with_settings(self, set: Settings = None) -> RunFile:
        """The same run file with more keys set; this one is unchanged.

        Of two keys that exclude each other, such as ``array.pitch`` and ``array.extent``, the one that is set replaces
        the other.
        """
        run = RunFile.__new__(RunFile)
        run._run = self._run.with_settings(typed(set))
        return run

    @property
    def path(self) -> Path | None:
        """The file, if it is from one."""
        return None if self._run.path is None else Path(self._run.path)

    @property
    def has_scene(self) -> bool:
        """Whether it names a scene."""
        return self._run.has_scene

    @property
    def hints(self) -> list[str]:
        """What may be wrong with the placement of a mesh that has no run file."""
        return self._run.hints

    def to_toml(self) -> str:
        """Every key with its value as TOML; read in the same folder, it gives an equal run file."""
        return self._run.to_toml()

    def to_dict(self) -> dict[str, Any]:
        """Every key with its value, by table; ``None`` where a key has none."""
        values: dict[str, Any] = json.loads(self._run.to_json())
        return values

    def __getitem__(self, key: str) -> Any:
        """The value of ``table.key``, or a whole table."""
        found: Any = self.to_dict()
        for part in key.split("."):
            if not isinstance(found, dict) or part not in found:
                raise KeyError(key)
            found = found[part]
        return found

    def __eq__(self, other: object) -> bool:
        return self._run.to_json() == other._run.to_json() if isinstance(other, RunFile) else NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        name = "no file" if self.path is None else repr(str(self.path))
        sweep = self["sweep"]
        band = f"{sweep['start'] / 1e3:g} to {sweep['stop'] / 1e3:g} kHz by {sweep['step']:g} Hz"
        return f"<RunFile {name}, {band}>"


def run_of(run: RunFile | PathLike | None, settings: list[str]) -> _holosonar.RunFile:
    """The run file of a job with its settings: given, read from a file, or the defaults."""
    if isinstance(run, RunFile):
        return run._run.with_settings(settings) if settings else run._run
    return RunFile(run, set=settings)._run
