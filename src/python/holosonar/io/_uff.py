"""USTB's ultrasound file format, UFF: channel data of a probe, one spherical wave or one for each element."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._cubes import Cube, Geometry, float64
from .._errors import InputError
from .._run_file import PathLike
from ._files import check_size, dataset, numbers, opened_hdf5, refusal, scalar, subgroup
from ._responses import check_tones, cube_of, fourier_sum

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

_WHAT = "a file of USTB's ultrasound file format (UFF)"
_SPHERICAL = 1.0


def read_uff(
    path: PathLike,
    *,
    frequencies: ArrayLike,
    name: str = "channel_data",
    wave: int | None = None,
    monostatic: bool = False,
    frame: int = 0,
    sound_speed: float | None = None,
) -> Cube:
    """Reads channel data of USTB's UFF (.uff): echoes of a spherical wave, at the tones of a sweep.

    The echo of a point p at element r is expected where USTB's beamformer looks for it: time 0 is when the wave passes the
    origin, and ``delay`` of the wave is what the acquisition starts later. From these the time since the sound left the source
    is found.

    Parameters
    ----------
    path : path
    frequencies : array_like, shape (n_f,)
        Tones, Hz, ascending, within the pulse's band. Data in a base band are taken back to theirs.
    name : str
        Group of the channel data in the file.
    wave : int, optional
        Which transmission, counted from 0; needed if there are several, unless ``monostatic``.
    monostatic : bool
        Of one wave from each element, the echoes that come back to that element: the diagonal of the full matrix.
    frame : int
        Counted from 0.
    sound_speed : float, optional
        m/s; left out, that of the file.

    Returns
    -------
    Cube
        Of shape (n_f, n_element), or (n_f, n_y, n_x) if the probe's elements fill a raster. Positions are the file's, whose
        axes are ours: z goes from the probe into the medium.

    Raises
    ------
    InputError
        Plane and focused waves, which are from no point; elements, waves or frames that are not there; tones beyond half of
        the sample rate.
    NotFoundError, ImportError
    """
    import numpy as np

    tones = np.atleast_1d(float64(frequencies, "frequencies"))
    kind: Geometry = "monostatic" if monostatic else "fixed-source"
    source = (0.0, 0.0, 0.0)
    if monostatic and wave is not None:
        raise InputError("wave: monostatic=True takes the waves of all elements; give one of the two")
    with opened_hdf5(path, _WHAT) as root:
        group = subgroup(root, name, path, "the channel data")
        rate = scalar(group, "sampling_frequency", path, "Hz")
        first = scalar(group, "initial_time", path, "s")
        carrier = scalar(group, "modulation_frequency", path, "Hz") if "modulation_frequency" in group else 0.0
        speed = scalar(group, "sound_speed", path, "m/s")
        probe = subgroup(group, "probe", path, "the elements")
        placed = numbers(probe, "geometry", path, "x, y, z of each element")
        if placed.ndim != 2 or placed.shape[0] < 3:
            raise refusal(path, f"`{name}/probe/geometry`: 7 numbers for each element were expected, not {list(placed.shape)}")
        elements = np.ascontiguousarray(placed[:3].T)
        waves = _waves(path, group, speed)
        parts = _parts(path, group, len(elements), len(waves))
        n_read = len(waves) if monostatic and parts[0].held.chunks is not None else 1
        check_size(8 * len(parts) * n_read * len(elements) * parts[0].shape[3], f"`{name}/data`", path)
        if not 0 <= frame < parts[0].shape[0]:
            raise refusal(path, f"`{name}/data`: has {parts[0].shape[0]} frames; frame={frame} counts from 0")
        if monostatic:
            at = _firing(path, waves, elements)
            signals = _diagonal(parts, frame, at)
            starts = np.array([first - waves[w].emitted for w in at])
        else:
            index = _chosen(path, waves, wave)
            signals = _signal(parts, frame, index, slice(None))
            starts = np.full(len(elements), first - waves[index].emitted)
            source = waves[index].source
    check_tones(tones, rate, signals.dtype.kind == "c", carrier)
    # The base band was made with the file's own time, which is not counted from when the sound left the source.
    spectrum = fourier_sum(signals, rate, tones - carrier, first)
    late = np.outer(tones, starts - first)
    spectrum *= np.exp(-2j * np.pi * (late - np.round(late)))
    return cube_of(spectrum, tones, elements, source, sound_speed or speed, kind)


class _Wave:
    """A transmission: where it is from, and when the sound left there, in the time of the file."""

    def __init__(self, path: PathLike, group: Any, speed: float) -> None:
        label = group.name.lstrip("/")
        kind = scalar(group, "wavefront", path, "0, 1 or 2") if "wavefront" in group else _SPHERICAL
        self.source = _xyz(path, subgroup(group, "source", path, "the point from which the wave comes"))
        distance = sum(x * x for x in self.source) ** 0.5
        if kind != _SPHERICAL or distance == float("inf"):
            raise refusal(path, f"`{label}`: a spherical wave was expected; plane and photoacoustic ones are from no point")
        if self.source[2] > 1e-3:
            raise refusal(path, f"`{label}`: is focused at z = {self.source[2]:g} m, and so is from no point")
        speed = scalar(group, "sound_speed", path, "m/s") if "sound_speed" in group else speed
        if not speed > 0:
            raise refusal(path, f"`{label}/sound_speed`: a positive speed was expected, not {speed}")
        delay = scalar(group, "delay", path, "s") if "delay" in group else 0.0
        # USTB takes the distance to the origin off for sources behind the probe, and adds it for those in its plane.
        passing = -distance if self.source[2] < -1e-3 else distance
        self.emitted = passing / speed - delay


def _xyz(path: PathLike, point: Any) -> tuple[float, float, float]:
    """A point, m, from its distance, azimuth and elevation."""
    import math

    distance, azimuth, elevation = (
        scalar(point, key, path, "of a point") if key in point else 0.0 for key in ("distance", "azimuth", "elevation")
    )
    if math.isinf(distance):
        return (0.0, 0.0, distance)
    across = distance * math.cos(elevation)
    return (across * math.sin(azimuth), distance * math.sin(elevation), across * math.cos(azimuth))


def _waves(path: PathLike, group: Any, speed: float) -> list[_Wave]:
    """The transmissions, in order."""
    sequence = subgroup(group, "sequence", path, "the waves that were sent")
    several = sorted(key for key in sequence if key.startswith("sequence_"))
    if not several:
        return [_Wave(path, sequence, speed)]
    return [_Wave(path, subgroup(sequence, key, path, "a wave"), speed) for key in several]


def _parts(path: PathLike, group: Any, n_elements: int, n_waves: int) -> list[Any]:
    """The data as one dataset, or two for real and imaginary parts, with axes [frame, wave, element, sample]."""
    held, label = group.get("data"), f"{group.name.lstrip('/')}/data"
    is_complex = hasattr(held, "items")
    holder, keys = (held, ("real", "imag")) if is_complex else (group, ("data",))
    parts = [dataset(holder, key, path, "[sample, element, wave, frame]") for key in keys]
    shape = (1,) * (4 - len(parts[0].shape)) + tuple(parts[0].shape)
    if len(shape) != 4 or shape[1:3] != (n_waves, n_elements) or parts[0].shape != parts[-1].shape:
        wanted = f"[sample, {n_elements} elements, {n_waves} waves, frame] was expected"
        raise refusal(path, f"`{label}`: has the shape {list(reversed(parts[0].shape))}; {wanted}")
    return [_Padded(part, shape) for part in parts]


class _Padded:
    """A dataset on disk with axes of length 1 before its own."""

    def __init__(self, held: Any, shape: tuple[int, ...]) -> None:
        self.held, self.shape = held, shape

    def __getitem__(self, index: tuple[Any, ...]) -> Any:
        return self.held[index[4 - len(self.held.shape) :]]


def _signal(parts: list[Any], frame: int, wave: Any, element: Any) -> NDArray[Any]:
    """Signals of one wave or element, or of a slice of them: only these are read."""
    read = [part[frame, wave, element, slice(None)] for part in parts]
    held: NDArray[Any] = read[0] if len(read) == 1 else read[0] + 1j * read[1]
    return held


def _diagonal(parts: list[Any], frame: int, at: list[int]) -> NDArray[Any]:
    """For each element the signal of the wave that it sent."""
    import numpy as np

    if parts[0].held.chunks is None:
        return np.stack([_signal(parts, frame, wave, element) for element, wave in enumerate(at)])
    # MATLAB makes one chunk of all, which would be read again for each element.
    whole = _signal(parts, frame, slice(None), slice(None)).reshape(parts[0].shape[1:])
    return whole[at, np.arange(len(at))]


def _chosen(path: PathLike, waves: list[_Wave], wave: int | None) -> int:
    if wave is None and len(waves) > 1:
        echoes = "monostatic=True the echoes that return to the element that sent"
        raise refusal(path, f"has {len(waves)} waves: wave=0 takes the first; {echoes}")
    index = wave or 0
    if not 0 <= index < len(waves):
        raise refusal(path, f"has {len(waves)} waves; wave={index} counts from 0")
    return index


def _firing(path: PathLike, waves: list[_Wave], elements: NDArray[np.float64]) -> list[int]:
    """For each element the wave that it sent."""
    import numpy as np

    sources = np.array([sent.source for sent in waves])
    extent = float(np.ptp(elements, axis=0).max(initial=0.0))
    found = []
    for element, place in enumerate(elements):
        away = np.linalg.norm(sources - place, axis=1)
        nearest = int(away.argmin())
        if away[nearest] > 1e-5 * max(extent, 1e-6):
            nearby = f"the nearest is {away[nearest]:g} m away"
            raise refusal(path, f"no wave is from element {element}, which monostatic=True needs: {nearby}")
        found.append(nearest)
    return found
