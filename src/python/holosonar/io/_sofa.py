"""SOFA files (AES69): impulse responses or transfer functions from sources to receivers, in HDF5."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from .._cubes import Cube, Geometry, float64
from .._run_file import PathLike
from ._files import attribute_text, dataset, numbers, opened_hdf5, refusal
from ._responses import cube_of, from_impulse_responses
from ._sofa_places import places

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

_WHAT = "a SOFA file"


def read_sofa(
    path: PathLike,
    *,
    frequencies: ArrayLike | None = None,
    measurement: int | None = None,
    emitter: int | None = None,
    frame: Literal["sofa", "array"] = "sofa",
    sound_speed: float = 343.0,
    latency: float = 0.0,
) -> Cube:
    """Reads a SOFA file (.sofa) of impulse responses (``Data.IR``) or of transfer functions (``Data.Real``, ``Data.Imag``).

    Receivers are placed about their listener and emitters about their source, with their views, as the standard defines it. If
    the source stands still, the measurements are microphones of one array, which was moved; if source and microphone are at
    the same place in each, the scan is monostatic.

    Parameters
    ----------
    path : path
    frequencies : array_like, shape (n_f,)
        Tones, Hz, ascending. Needed for impulse responses; of transfer functions those of the file that are wanted, all above
        0 Hz if left out.
    measurement : int, optional
        The only one that is taken, counted from 0; needed if sources differ between measurements.
    emitter : int, optional
        Counted from 0; needed if there are several.
    frame : {"sofa", "array"}
        ``"sofa"``: x of the file goes ahead, y to the left, z up, as the standard has it, and ahead becomes z of the cube.
        ``"array"``: the file's x, y and z are taken as the cube's.
    sound_speed : float
        m/s.
    latency : float
        Time by which all responses are late, s.

    Returns
    -------
    Cube
        Of shape (n_f, n_mic), or (n_f, n_y, n_x) if the microphones fill a raster. ``Data.Delay`` is part of the paths.

    Raises
    ------
    InputError
        Other types of data, coordinates or units; tones that the file does not have.
    NotFoundError, ImportError
    """
    import numpy as np

    with opened_hdf5(path, _WHAT) as root:
        kind = attribute_text(root, "DataType")
        is_response = "Data.IR" in root
        if not is_response and not ("Data.Real" in root and "Data.Imag" in root):
            there = ", ".join(sorted(key for key in root if key.startswith("Data."))) or "none"
            wanted = "`Data.IR`, or `Data.Real` and `Data.Imag`, were expected"
            raise refusal(path, f"{wanted}; the DataType is {kind!r} and its data are {there}")
        data = dataset(root, "Data.IR" if is_response else "Data.Real", path, "the data")
        stored = data.shape
        if len(stored) not in (3, 4):
            raise refusal(path, f"`{data.name.lstrip('/')}`: [M, R, N] was expected, not {list(stored)}")
        # Emitters are the last axis, and in the older type FIRE the last but one.
        is_old = kind == "FIRE" and len(stored) == 4
        shape = (*stored[:2], stored[3], stored[2]) if is_old else stored
        microphones, sources = places(root, path, shape[0], shape[1], frame)
        chosen = _measurements(path, microphones, sources, measurement)
        pick = _emitter(path, shape, sources.shape[1], emitter)
        sources = sources[:, pick]
        moving = len(chosen) > 1 and bool((sources != sources[chosen[0]]).any())
        geometry: Geometry = "monostatic" if moving else "fixed-source"
        at = (0.0, 0.0, 0.0) if moving else (float(sources[chosen[0], 0]), *map(float, sources[chosen[0], 1:]))
        source = (at[0], at[1], at[2])
        positions = microphones[chosen].reshape(-1, 3)

        def taken(name: str) -> NDArray[np.float64]:
            held = numbers(root, name, path, "the data")
            if held.shape != stored:
                raise refusal(path, f"`{name}`: has the shape {list(held.shape)}; {list(stored)} was expected")
            held = np.moveaxis(held, 2, 3) if is_old else held
            return (held[..., pick] if held.ndim == 4 else held)[chosen].reshape(-1, shape[2])

        if is_response:
            if frequencies is None:
                raise refusal(path, "`Data.IR`: impulse responses need `frequencies`, the tones")
            rate = _sample_rate(root, path)
            start = _delays(root, path, shape, pick)[chosen].reshape(-1) / rate - latency
            return from_impulse_responses(
                taken("Data.IR"), rate, positions, source, frequencies=frequencies, sound_speed=sound_speed,
                geometry=geometry, start=start,
            )  # fmt: skip
        spectrum = (taken("Data.Real") + 1j * taken("Data.Imag")).T
        tones, index = _tones(root, path, shape[2], frequencies)
    spectrum = spectrum[index] * np.exp(2j * np.pi * tones * latency)[:, None]
    return cube_of(spectrum, tones, positions, source, sound_speed, geometry)


def _measurements(
    path: PathLike, microphones: NDArray[np.float64], sources: NDArray[np.float64], measurement: int | None
) -> list[int]:
    """Which measurements make the array."""
    import numpy as np

    count = len(microphones)
    if measurement is not None:
        if not 0 <= measurement < count:
            raise refusal(path, f"has {count} measurements; measurement={measurement} counts from 0")
        return [measurement]
    still = bool((sources == sources[0]).all())
    together = microphones.shape[1] == 1 and sources.shape[1] == 1 and np.allclose(microphones, sources, rtol=0.0, atol=1e-9)
    if count > 1 and bool((microphones == microphones[0]).all()) or not (still or together):
        raise refusal(
            path,
            f"has {count} measurements " + ("at the same places" if still else "from sources that differ")
            + ": measurement=0 takes the first; a cube has one loudspeaker, or one that moves with its microphone",
        )  # fmt: skip
    return list(range(count))


def _emitter(path: PathLike, shape: tuple[int, ...], count: int, emitter: int | None) -> int:
    """Which emitter of the source; the data of several have a fourth axis."""
    if len(shape) == 3 and count > 1:
        raise refusal(path, f"has {count} emitters, but data of the shape {list(shape)}, for one")
    if len(shape) == 4 and shape[3] != count:
        raise refusal(path, f"has {count} emitters, but data of the shape {list(shape)}; [M, R, N, E] was expected")
    if count > 1 and emitter is None:
        raise refusal(path, f"has {count} emitters: emitter=0 takes the first")
    if not 0 <= (emitter or 0) < count:
        raise refusal(path, f"has {count} emitters; emitter={emitter} counts from 0")
    return emitter or 0


def _sample_rate(root: Any, path: PathLike) -> float:
    """Hz, the same of all measurements."""
    import numpy as np

    rates = np.unique(numbers(root, "Data.SamplingRate", path, "Hz"))
    units = attribute_text(root["Data.SamplingRate"], "Units") or "hertz"
    if len(rates) != 1 or units.lower() not in ("hertz", "hz"):
        raise refusal(path, f"`Data.SamplingRate`: one rate in hertz was expected, not {rates.tolist()} {units}")
    return float(rates[0])


def _delays(root: Any, path: PathLike, shape: tuple[int, ...], emitter: int) -> NDArray[np.float64]:
    """``Data.Delay``, samples, shape (M, R): the response begins that much later."""
    import numpy as np

    if "Data.Delay" not in root:
        return np.zeros(shape[:2])
    held = numbers(root, "Data.Delay", path, "samples")
    if held.ndim == 3:
        held = held[..., emitter if held.shape[2] > 1 else 0]
    try:
        return np.array(np.broadcast_to(held, shape[:2]))
    except ValueError:
        raise refusal(path, f"`Data.Delay`: has the shape {list(held.shape)}; [1 or M, R] was expected") from None


def _tones(
    root: Any, path: PathLike, count: int, wanted: ArrayLike | None
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Frequencies, Hz, and where they are in the file, whose axis N they are."""
    import numpy as np

    there = numbers(root, "N", path, "the frequencies of transfer functions").reshape(-1)
    units = attribute_text(root["N"], "Units") or "hertz"
    if len(there) != count or units.lower() not in ("hertz", "hz"):
        raise refusal(path, f"`N`: {count} frequencies in hertz were expected, not {len(there)} in {units}")
    if wanted is None:
        index = np.flatnonzero(there > 0)
        return there[index], index
    tones = np.atleast_1d(float64(wanted, "frequencies"))
    index = np.abs(there[None, :] - tones[:, None]).argmin(axis=1)
    away = np.abs(there[index] - tones)
    if (away > 1e-6 * tones).any():
        missing = tones[int(np.argmax(away))]
        raise refusal(path, f"`N`: {missing:g} Hz is none of its {count} frequencies, {there.min():g} to {there.max():g} Hz")
    return there[index], index
