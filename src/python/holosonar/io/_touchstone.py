"""Touchstone files of a network analyser, one for each position, read by scikit-rf."""

from __future__ import annotations

import glob
import os
import re
from typing import TYPE_CHECKING, Any

from .._cubes import Cube, Geometry, float64
from .._errors import InputError, NotFoundError
from .._run_file import PathLike
from ._files import existing, library, refusal
from ._responses import cube_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import ArrayLike, NDArray

_ENDING = re.compile(r"\.s\d+p$", re.IGNORECASE)
_NUMBER = r"([-+]?\d+(?:\.\d+)?)"
_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}


def read_touchstone(
    files: PathLike | Sequence[PathLike],
    positions: ArrayLike | None = None,
    *,
    name_unit: str | None = None,
    ports: tuple[int, int] | None = None,
    source: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sound_speed: float = 343.0,
    geometry: Geometry = "fixed-source",
) -> Cube:
    """Reads one S parameter of Touchstone files (.s1p, .s2p, ...), one file for each position of the antenna or microphone.

    Parameters
    ----------
    files : path or sequence of paths
        A pattern whose ``{x}`` and ``{y}`` stand for the positions, as ``"scan/x{x}_y{y}.s2p"``; or a folder, whose files are
        taken by name with numbers in order (2 before 10); or a list.
    positions : array_like, shape (n_mic, 3) or (n_y, n_x, 3), optional
        m, in the order of the files; needed unless the names say them.
    name_unit : {"m", "cm", "mm", "in", "ft"}
        Of ``{x}`` and ``{y}``, and needed with them: no name says it.
    ports : (int, int), optional
        Port of the receiver, then of the sender, from 1 on: (2, 1) is S21. Left out, S21 of two ports and S11 of one.
    source, sound_speed, geometry
        As in :func:`from_impulse_responses`; light has 299792458 m/s.

    Returns
    -------
    Cube
        Of shape (n_f, n_y, n_x), or (n_f, n_mic) where positions fill no raster. Phases of S parameters fall along a path:
        samples are conjugated.

    Raises
    ------
    InputError
        Files whose frequencies differ, that lack the port, or whose positions are not known.
    NotFoundError, ImportError
    """
    import numpy as np

    if isinstance(files, (str, os.PathLike)):
        paths, named = _matching(os.fspath(files), name_unit)
    else:
        paths, named = [existing(path) for path in files], None
    if positions is not None:
        places = float64(positions, "positions", 3).reshape(-1, 3)
    elif named is not None:
        places = named
    else:
        raise InputError(
            "positions: are needed, in the order of the files, unless their names say them: \"scan/x{x}_y{y}.s2p\""
        )
    if not paths:
        raise InputError("files: one Touchstone file for each position was expected, and none was given")
    if len(places) != len(paths):
        raise InputError(f"positions: are {len(places)}, but there are {len(paths)} files; one each was expected")
    frequencies: NDArray[np.float64] | None = None
    columns = []
    for path in paths:
        network = _network(path)
        if frequencies is None:
            frequencies = np.asarray(network.f, np.float64)
        elif network.f.shape != frequencies.shape or not np.allclose(network.f, frequencies, rtol=1e-9, atol=0.0):
            raise refusal(path, f"its frequencies are not those of {paths[0]}")
        columns.append(_parameter(path, network, ports))
    assert frequencies is not None
    return cube_of(np.stack(columns, axis=1), frequencies, places, source, sound_speed, geometry)


def _network(path: str) -> Any:
    skrf = library("skrf")
    try:
        return skrf.Network(path)
    except Exception as error:  # scikit-rf raises whatever a damaged file leads it to.
        raise refusal(path, f"cannot be read as a Touchstone file: {error}") from error


def _parameter(path: str, network: Any, ports: tuple[int, int] | None) -> NDArray[Any]:
    """S of one pair of ports, shape (n_f,)."""
    import numpy as np

    count = int(network.nports)
    if ports is None:
        if count > 2:
            raise refusal(path, f"has {count} ports: say which with `ports`, (2, 1) for S21")
        ports = (count, 1)
    to, sender = ports
    if not (1 <= to <= count and 1 <= sender <= count):
        raise refusal(path, f"has {count} ports, but `ports` are {ports}, counted from 1")
    return np.asarray(network.s[:, to - 1, sender - 1])


def _matching(name: str, unit: str | None) -> tuple[list[str], NDArray[np.float64] | None]:
    """Files of a folder, or of a pattern with their positions."""
    import numpy as np

    if os.path.isdir(name):
        names = sorted((entry for entry in os.listdir(name) if _ENDING.search(entry)), key=_by_number)
        if not names:
            raise refusal(name, "no Touchstone file (.s1p, .s2p, ...) is in this folder")
        return [os.path.join(name, entry) for entry in names], None
    if "{x}" not in name and "{y}" not in name:
        return [existing(name)], None
    if unit not in _UNITS:
        raise InputError(f"name_unit: one of {', '.join(_UNITS)} was expected, the unit of {{x}} and {{y}}, not {unit!r}")
    fields = re.split(r"\{([xy])\}", name)
    if sorted(fields[1::2]) != sorted(set(fields[1::2])):
        raise InputError(f"files: {{x}} and {{y}} may be once each in {name!r}")
    expression = "".join(_NUMBER if i % 2 else re.escape(field) for i, field in enumerate(fields))
    pattern = "".join("*" if i % 2 else glob.escape(field) for i, field in enumerate(fields))
    found = []
    for path in sorted(glob.glob(pattern), key=_by_number):
        match = re.fullmatch(expression, path)
        if match:
            at = dict(zip(fields[1::2], (float(number) for number in match.groups())))
            found.append((path, (at.get("x", 0.0), at.get("y", 0.0), 0.0)))
    if not found:
        missing = NotFoundError(f"{name}: no file has such a name, with numbers for {{x}} and {{y}}")
        missing.place = name
        raise missing
    return [path for path, _ in found], np.array([at for _, at in found]) * _UNITS[unit]


def _by_number(name: str) -> list[Any]:
    """Orders names as people do, 2 before 10."""
    parts = re.split(r"(\d+)", name)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)]
