"""MATLAB files of samples over frequency, or of impulse responses over time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations
from typing import TYPE_CHECKING, Any, Literal, Union

from .._cubes import Cube, Geometry, float64
from .._errors import InputError
from .._run_file import PathLike
from ._files import refusal
from ._mat_file import listing, variables
from ._responses import cube_of, from_impulse_responses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

#: A variable by its name, or the numbers themselves.
Named = Union[str, "ArrayLike", None]

_AXES = ("f", "t", "x", "y", "mic", "-")


def read_matlab(
    path: PathLike,
    samples: str | tuple[str, str] | None = None,
    *,
    axes: Sequence[Literal["f", "t", "x", "y", "mic", "-"]] | None = None,
    frequencies: Named = None,
    positions: Named = None,
    sample_rate: str | float | None = None,
    phase_sign: Literal[1, -1] | None = None,
    frequency_unit: float = 1.0,
    position_unit: float = 1.0,
    source: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sound_speed: float = 343.0,
    geometry: Geometry = "fixed-source",
    start: float = 0.0,
) -> Cube:
    """Reads samples from a MATLAB file, of versions 4 to 7 (by SciPy) or 7.3 (by h5py).

    All numeric variables of the file are read, since any of them could be meant.

    Parameters
    ----------
    path : path
    samples : str or (str, str), optional
        Variable of the complex samples, or of the responses over time; a field of a structure is ``"structure.field"``. Two are
        I and Q. Left out, the only variable that fits.
    axes : sequence of {"f", "t", "x", "y", "mic", "-"}, optional
        What the axes of ``samples`` are, in MATLAB's order: frequencies or time, columns and rows of the array or all
        microphones, and ``"-"`` for one of length 1. Left out, the lengths must leave a single order of "f" with "mic", or
        with "x" and "y".
    frequencies : str or array_like, shape (n_f,), optional
        Variable, or the numbers. Left out, the only variable that fits. With "t" the tones, which must be given.
    positions : str or array_like, optional
        Microphones, (n_mic, 3), (3, n_mic) or (n_y, n_x, 3): variable, or the numbers. Left out, the only variable that fits.
    sample_rate : str or float
        Of responses over time: variable, or Hz.
    phase_sign : {1, -1}
        Of samples over frequency, and needed for them: -1 if phases fall along a path, as those of a Fourier transform or of a
        network analyser do, else 1. No file says it.
    frequency_unit, position_unit : float
        Hz and m that a 1 in the file stands for: 1e3 of kHz, 1e-3 of mm. Of variables only.
    source, sound_speed, geometry, start
        As in :func:`from_impulse_responses`.

    Returns
    -------
    Cube
        Of shape (n_f, n_y, n_x) or (n_f, n_mic).

    Raises
    ------
    InputError
        What the file does not say, with the variables that it has.
    NotFoundError, ImportError
    """
    import numpy as np

    found = variables(path)
    pair = samples if isinstance(samples, tuple) else (samples,)
    taken = {name for name in (*pair, frequencies, positions, sample_rate) if isinstance(name, str)}
    reader = _Variables(path, found, taken)
    given_axes = None if axes is None else _checked_axes(axes)
    if given_axes is not None and "t" in given_axes and (frequencies is None or sample_rate is None):
        raise refusal(path, "responses over time need `frequencies`, the tones, and `sample_rate`")
    name, values = reader.samples(samples, given_axes)
    taken.add(name)
    places = reader.positions(positions, position_unit)
    tones = reader.frequencies(frequencies, frequency_unit, values.shape)
    values, order = _ordered(path, name, values, given_axes, len(tones), places)
    flat = places.reshape(-1, 3)
    if "t" in order:
        rate = reader.number(sample_rate, "sample_rate")
        moved = np.moveaxis(values, order.index("t"), -1).reshape(len(flat), -1)
        return from_impulse_responses(
            moved, rate, flat, source, frequencies=tones, sound_speed=sound_speed, geometry=geometry, start=start
        )
    if start != 0.0:
        raise refusal(path, f"`{name}`: `start` is of responses over time; these are samples over frequency")
    if phase_sign not in (1, -1):
        raise refusal(
            path,
            f"`{name}`: phase_sign must be -1 if phases fall along a path, as those of a Fourier transform or of a network "
            "analyser do, or 1 if they grow; no file says it",
        )
    if values.dtype.kind != "c":
        raise refusal(path, f"`{name}`: complex samples were expected, not {values.dtype}; of responses name the axis \"t\"")
    moved = np.moveaxis(values, order.index("f"), 0).reshape(len(tones), -1)
    return cube_of(moved, tones, flat, source, sound_speed, geometry, phase_sign)


class _Variables:
    """The variables of a file, and which of them is what; those that are taken by name are nothing else."""

    def __init__(self, path: PathLike, found: dict[str, NDArray[Any]], taken: set[str]) -> None:
        self.path, self.found, self.taken = path, found, taken

    def refused(self, message: str) -> InputError:
        return refusal(self.path, f"{message}; the file has {listing(self.found)}")

    def _named(self, name: str, what: str) -> NDArray[Any]:
        if name not in self.found:
            raise self.refused(f"`{name}`, {what}, is missing")
        return self.found[name]

    def _only(self, fits: Callable[[NDArray[Any]], bool], what: str, key: str) -> str:
        """The name of the only variable that fits and is nothing else yet."""
        fitting = [name for name, value in self.found.items() if name not in self.taken and fits(value)]
        if len(fitting) != 1:
            several = f"{len(fitting)} variables could be" if fitting else "no variable can be"
            raise self.refused(f"{several} {what}; name it with `{key}`")
        return fitting[0]

    def samples(self, name: str | tuple[str, str] | None, axes: tuple[str, ...] | None) -> tuple[str, NDArray[Any]]:
        """Samples, or responses over time: by name, or the only array of enough axes (complex, if over frequency)."""
        if isinstance(name, tuple):
            i, q = (self._named(part, "I and Q of the samples") for part in name)
            if i.shape != q.shape or "c" in (i.dtype.kind, q.dtype.kind):
                raise self.refused(f"`{name[0]}`, `{name[1]}`: real I and Q of the same shape were expected")
            return name[0], i + 1j * q
        if name is None:
            real = axes is not None and "t" in axes
            least = 2 if axes is None else sum(axis != "-" for axis in axes)

            def fits(value: NDArray[Any]) -> bool:
                enough = sum(n > 1 for n in value.shape) >= min(least, 2)
                return enough and (value.shape[-1] != 3 if real else value.dtype.kind == "c")

            name = self._only(fits, "the samples", "samples")
        return name, self._named(name, "the samples")

    def positions(self, given: Named, unit: float) -> NDArray[Any]:
        """Positions, m, shape (n_mic, 3) or (n_y, n_x, 3)."""
        if given is not None and not isinstance(given, str):
            return float64(given, "positions", 3)
        name = given
        if name is None:

            def fits(value: NDArray[Any]) -> bool:
                return value.dtype.kind != "c" and 3 in (value.shape[0], value.shape[-1]) and value.size > 3

            name = self._only(fits, "the microphones' positions, [n_mic, 3] or [n_y, n_x, 3] in m", "positions")
        value = self._named(name, "the microphones' positions")
        if value.ndim == 2 and value.shape[0] == 3 and value.shape[1] != 3:
            value = value.T
        if value.shape[-1] != 3 or value.dtype.kind not in "iuf":
            raise self.refused(f"`{name}`: positions [n_mic, 3], [3, n_mic] or [n_y, n_x, 3] were expected")
        return float64(value * unit, name)

    def frequencies(self, given: Named, unit: float, lengths: tuple[int, ...]) -> NDArray[Any]:
        """Frequencies, Hz, shape (n_f,)."""
        import numpy as np

        if given is not None and not isinstance(given, str):
            return np.atleast_1d(float64(given, "frequencies"))
        name = given
        if name is None:

            def fits(value: NDArray[Any]) -> bool:
                if value.dtype.kind not in "iuf" or value.size not in lengths or value.size != max(value.shape):
                    return False
                flat = value.reshape(-1).astype(np.float64)
                return bool((np.diff(flat) > 0).all() and flat[0] > 0)

            name = self._only(fits, "the frequencies: ascending, as many as an axis of the samples is long", "frequencies")
        value = self._named(name, "the frequencies")
        if value.size != max(value.shape) or value.dtype.kind not in "iuf":
            raise self.refused(f"`{name}`: a vector of frequencies was expected")
        return float64(value.reshape(-1) * unit, name)

    def number(self, given: str | float | None, key: str) -> float:
        if not isinstance(given, str):
            return float(given or 0.0)
        value = self._named(given, f"the {key}")
        if value.size != 1 or value.dtype.kind not in "iuf":
            raise self.refused(f"`{given}`: one number was expected, the {key}")
        return float(value.reshape(-1)[0])


def _checked_axes(axes: Sequence[str]) -> tuple[str, ...]:
    named = tuple(axes)
    kinds = sorted(axis for axis in named if axis != "-")
    if kinds not in [sorted((first, *others)) for first in "ft" for others in (["mic"], ["x", "y"], ["x"], ["y"])]:
        raise InputError(
            f"axes: {list(named)} are none of {list(_AXES)} each once, \"f\" or \"t\" with \"mic\" or with \"x\" and \"y\""
        )
    return named


def _ordered(
    path: PathLike, name: str, values: NDArray[Any], axes: tuple[str, ...] | None, n_f: int, places: NDArray[Any]
) -> tuple[NDArray[Any], list[str]]:
    """The samples with their axes named, y before x, so that microphones come in the order of their positions."""
    import numpy as np

    n_mic = places.size // 3
    lengths = {"f": n_f, "mic": n_mic}
    if places.ndim == 3:
        lengths |= {"y": places.shape[0], "x": places.shape[1]}
    shape = list(values.shape)

    def fits(order: tuple[str, ...], sizes: list[int]) -> bool:
        return len(order) == len(sizes) and all(n == lengths.get(axis, n) for axis, n in zip(order, sizes))

    if axes is None:
        sizes = [n for n in shape if n > 1] if len(shape) > 2 or 1 in shape else shape
        kinds = [("f", "mic"), ("f", "y", "x")] if places.ndim == 3 else [("f", "mic")]
        orders = [order for kind in kinds for order in permutations(kind) if fits(order, sizes)]
        if len(orders) != 1:
            why = "more than one order of axes fits" if orders else "no order of axes fits"
            there = f"{n_f} frequencies and {list(places.shape[:-1])} microphones"
            raise refusal(path, f"`{name}`: {why} its shape {shape}, {there}; say `axes`")
        values, order = values.reshape(sizes), list(orders[0])
    else:
        # MATLAB drops axes of length 1 at the end, and has two at least.
        shape += [1] * (len(axes) - len(shape))
        if len(shape) > len(axes):
            shape = shape[: len(axes)] if set(shape[len(axes) :]) == {1} else shape
        singles = all(n == 1 for axis, n in zip(axes, shape) if axis == "-")
        if not singles or not fits(axes, shape):
            meant = ", ".join(f'"{axis}"' + (f" {lengths[axis]}" if axis in lengths else "") for axis in axes)
            raise refusal(path, f"`{name}`: has the shape {list(values.shape)}, which is not that of the axes {meant}")
        order = [axis for axis in axes if axis != "-"]
        values = values.reshape([n for axis, n in zip(axes, shape) if axis != "-"])
        if {"x", "y"} <= set(order) and places.ndim != 3:
            needed = "positions [n_y, n_x, 3] are needed, which say their order"
            raise refusal(path, f"`{name}`: with the axes \"x\" and \"y\" {needed}")
        if values.size != n_mic * values.shape[order.index("f" if "f" in order else "t")]:
            raise refusal(path, f"`{name}`: has the shape {list(values.shape)}, but there are positions of {n_mic} microphones")
    if "x" in order and "y" in order and order.index("x") < order.index("y"):
        ix, iy = order.index("x"), order.index("y")
        values = np.swapaxes(values, ix, iy)
        order[ix], order[iy] = "y", "x"
    return values, order
