"""Commands whose files are in an object store: a worker that shares no folder with others works on copies.

What a command is to read is copied into a folder of this process before it runs; what it left is copied to the store after it.
Of an output, units and combinations that others have finished are fetched before as well. Stores are those of fsspec.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Union

from ._errors import InputError, SystemFailure

_URL = re.compile(r"[a-z][a-z0-9+.-]*://")

#: Files of an input's folder beyond which it was hardly made for a job.
_MOST_FILES = 10_000

#: The ends of files that a store holds for other commands of the same job.
_UNITS = ".unit"
_COMBINATIONS = "combinations"

#: The ends of outputs that are files; all others are folders, as for the command.
_FILES = (".npz", ".zarr", ".wav", ".exr", ".vti", ".nrrd", ".vdb")


def is_url(path: object) -> bool:
    """Whether a path is in a store."""
    return isinstance(path, str) and _URL.match(path) is not None


def local_or_url(path: Union[str, os.PathLike[str]]) -> str:
    """A path that means the same to a process with another current folder."""
    return str(path) if is_url(path) else os.path.abspath(path)


@dataclass(frozen=True)
class Store:
    """What workers are told of a job whose files are in a store."""

    #: The call, whose copies have a folder of their own.
    job: str
    #: With which its units are sealed.
    secret: bytes = field(repr=False)
    #: Keywords of fsspec's file system, such as credentials.
    options: Mapping[str, Any] = field(repr=False)


def first_depth(done: Mapping[str, Any]) -> int:
    """The number of a job's first unit of depths: after those of the simulation and the sweep, before those of shards."""
    first: int = done["units"] - done["shards"] - done["depths"]
    return first


@dataclass(frozen=True)
class Units:
    """The units that a part of a job needs."""

    #: Their numbers.
    numbers: tuple[range, ...] = ()
    #: Instead of these all that an earlier job left, as far as they are there when a worker begins.
    left: bool = False

    @classmethod
    def of_part(cls, part: int, count: int, done: Mapping[str, Any]) -> Units:
        """What the depths of one of ``count`` parts, from 1 on, need of a job of which so much is done.

        That is themselves and the compressed sweep, or while there is none the simulation.
        """
        first = first_depth(done)
        (begin, end) = (first + done["depths"] * k // count for k in (part - 1, part))
        return cls((range(done["simulation"] if done["compressed"] else 0, first), range(begin, end)))

    @classmethod
    def of_shards(cls, shards: Sequence[Mapping[str, Any]]) -> Units:
        """What units of shards that follow one another need: themselves, and the depths from which they are encoded."""
        (begin, end) = (shards[0]["depths"][0], shards[-1]["depths"][1])
        return cls((range(begin, end + 1), range(shards[0]["unit"], shards[-1]["unit"] + 1)))

    def have(self, file: str) -> bool:
        """Whether a file is of one of them, or of what all processes of a job need."""
        number = file[: -len(_UNITS)].rpartition(".")[2]
        return self.left or not number.isdecimal() or any(int(number) in some for some in self.numbers)


class Copies:
    """A process's copies of the files of a job."""

    def __init__(self, store: Store, within: str | None = None) -> None:
        self._store = store
        self._folder = tempfile.TemporaryDirectory(prefix="holosonar-", dir=within)
        # Of everything that was copied, what it was like then.
        self._known: dict[Path, tuple[int, int]] = {}
        self._begun = False
        self._inputs: dict[str, Path] = {}
        self._outputs: dict[str, Path] = {}
        # Where the command looks for its user's secret.
        key = self.path / "state/holosonar/checkpoint.key"
        key.parent.mkdir(mode=0o700, parents=True)
        key.touch(mode=0o600)
        key.write_bytes(store.secret)
        #: The environment of commands.
        self.environment = {**os.environ, "XDG_STATE_HOME": str(self.path / "state")}

    @property
    def path(self) -> Path:
        """The folder of all of them."""
        return Path(self._folder.name)

    def close(self) -> None:
        """Deletes them."""
        self._folder.cleanup()

    def localised(self, arguments: Sequence[str]) -> list[str]:
        """Arguments of a command with paths of copies for URLs, of which those to be read are there."""
        words = list(arguments)
        # Outputs come first, for what lies in them is no input.
        for i, word in enumerate(words):
            if is_url(word) and i > 0 and words[i - 1] == "-o":
                words[i] = str(self._output(word))
        for i, word in enumerate(words):
            if is_url(word) and (i == 0 or words[i - 1] != "--set"):
                words[i] = str(self.input(word))
        return words

    def restored(self, text: str) -> str:
        """What a command printed, with URLs for paths of copies."""
        for url, path in self._outputs.items():
            text = text.replace(str(path), url)
        for url, path in self._inputs.items():
            text = text.replace(str(path), _split(url)[0])
        return text

    def input(self, url: str) -> Path:
        """The copy of a file, with all that is in its folder, since a run file or mesh names others; of a cube that alone.

        Raises
        ------
        InputError
            There is no such file, or more beside it than belongs to a job.
        """
        (system, path) = self._system(url)
        (parent, name) = _split(url)
        folder = self._inputs.get(url)
        if folder is None:
            if not system.exists(path):
                raise InputError(f"{url} does not exist")
            folder = self._place("inputs", url)
            alone = name.endswith((".npz", ".zarr"))
            root = _split(path)[0]
            files = system.find(path if alone else root)
            if len(files) > _MOST_FILES and not name.endswith(".zarr"):
                problem = f"holds {len(files)} files; put {name} and what it names into a folder of their own"
                raise InputError(f"{parent}/ {problem}")
            # Not what lies in an output's folder, unless that is the input's own.
            outputs = tuple(f"{self._system(output)[1]}/" for output in self._outputs)
            below = tuple(output for output in outputs if output.startswith(f"{root}/") and output != f"{root}/")
            for file in files:
                if not file.startswith(below) and not file.endswith(_UNITS):
                    _fetch(system, file, _below(folder, file, root))
            self._inputs[url] = folder
        return folder / name

    def _output(self, url: str) -> Path:
        """Where a command is to write."""
        (parent, name) = _split(url)
        is_file = name.lower().endswith(_FILES)
        key = parent if is_file else url.rstrip("/")
        if key not in self._outputs:
            self._outputs[key] = self._place("outputs", key)
        return self._outputs[key] / name if is_file else self._outputs[key]

    def fetch(self, needed: Units | None = None) -> None:
        """Copies what other commands of the job have left for all of them, of units those that are needed."""
        (begun, self._begun) = (self._begun, True)
        if begun and needed is not None and needed.left:
            return
        for url, folder in self._outputs.items():
            (system, root) = self._system(url)
            system.invalidate_cache()
            found = {
                file: about
                for file, about in system.find(root, maxdepth=1, detail=True).items()
                if file.endswith(_UNITS) and (needed is None or needed.have(file))
            }
            found |= system.find(f"{root}/{_COMBINATIONS}", maxdepth=1, detail=True)
            for file, about in found.items():
                copy = _below(folder, file, root)
                # What another process was still writing is copied again: a folder, unlike an object store, shows part of it.
                if copy not in self._known or about.get("size") not in (None, self._known[copy][0]):
                    _fetch(system, file, copy)
                    # As the command itself makes them.
                    copy.chmod(0o600)
                    self._known[copy] = _state(copy)

    def store(self) -> None:
        """Copies what the command has finished to the store, and deletes there what it has deleted.

        Raises
        ------
        SystemFailure
            The store takes no files.
        """
        try:
            for url, folder in self._outputs.items():
                (system, root) = self._system(url)
                there = {copy: _state(copy) for copy in _finished(folder)}
                known = [copy for copy in self._known if copy.is_relative_to(folder)]
                for copy in dict.fromkeys([*there, *known]):
                    file = f"{root}/{copy.relative_to(folder).as_posix()}"
                    if copy not in there:
                        (size, _) = self._known.pop(copy)
                        # Not what was copied in part, and discarded as damaged.
                        with suppress(FileNotFoundError):
                            if system.info(file).get("size") in (None, size):
                                system.rm_file(file)
                    elif self._known.get(copy) != there[copy]:
                        system.makedirs(_split(file)[0], exist_ok=True)
                        system.put_file(str(copy), file)
                        self._known[copy] = there[copy]
        except OSError as error:
            raise SystemFailure(f"{url}: {error}") from error

    def _place(self, kind: str, url: str) -> Path:
        place = self.path / kind / hashlib.sha256(url.encode()).hexdigest()[:16]
        place.mkdir(parents=True, exist_ok=True)
        return place

    def _system(self, url: str) -> tuple[Any, str]:
        """The file system of a URL, and its path there, without a slash at its end."""
        try:
            core = importlib.import_module("fsspec.core")
        except ImportError as error:
            raise ImportError("fsspec is missing; pip install 'holosonar[all]', or fsspec") from error
        try:
            (system, path) = core.url_to_fs(url, **self._store.options)
        except ValueError as error:
            raise InputError(f"{url}: {error}") from error
        return system, path.rstrip("/")


def _split(url: str) -> tuple[str, str]:
    (parent, _, name) = url.rstrip("/").rpartition("/")
    return parent, name


def _below(folder: Path, file: str, root: str) -> Path:
    """Where the copy of a file below ``root`` belongs, whatever names a store has."""
    parts = file[len(root) + 1 :].split("/")
    if not file.startswith(f"{root}/") or any(part in ("", ".", "..") or os.sep in part for part in parts):
        raise InputError(f"{file} cannot be copied: it is no path below {root}")
    return folder.joinpath(*parts)


def _fetch(system: Any, file: str, copy: Path) -> None:
    copy.parent.mkdir(parents=True, exist_ok=True)
    system.get_file(file, str(copy))


def _state(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_size, status.st_mtime_ns


def _finished(folder: Path) -> Iterator[Path]:
    """The files that a command has finished: results, units, and combinations of a sweep."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and (not path.name.startswith(".") or path.name.endswith(_UNITS)):
            yield path


#: Those of this process, by job.
_COPIES: dict[str, Copies] = {}


def copies_of(store: Store, within: str | None = None) -> Copies:
    """This process's copies of the files of a job; ``within`` is a folder for them."""
    if store.job not in _COPIES:
        _COPIES[store.job] = Copies(store, within)
    return _COPIES[store.job]


def forget(job: str) -> None:
    """Deletes this process's copies of the files of a job."""
    copies = _COPIES.pop(job, None)
    if copies is not None:
        copies.close()
