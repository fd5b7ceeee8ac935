"""Instruments, reflectors and data cubes; simulation."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, overload

from . import _holosonar
from ._errors import InputError
from ._progress import Progress, reporting, warn_of_precision
from ._run_file import PathLike, RunFile, Settings, run_of, typed

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from numpy.typing import ArrayLike, NDArray

Geometry = Literal["fixed-source", "monostatic", "pair"]
Detection = Literal["quadrature", "in-phase"]


def float64(values: ArrayLike, name: str, last: int | None = None) -> NDArray[np.float64]:
    """Numbers as contiguous float64; copied only where they are not that already."""
    import numpy as np

    array = np.ascontiguousarray(values, dtype=np.float64)
    if last is not None and (array.ndim == 0 or array.shape[-1] != last):
        raise InputError(f"{name}: must have {last} coordinates along the last axis, not the shape {list(array.shape)}")
    return array


def complex64(values: ArrayLike, name: str, stacklevel: int = 2) -> NDArray[np.complex64]:
    """Numbers as contiguous complex64; says so where that loses precision."""
    import numpy as np

    array = np.asarray(values)
    if array.dtype.kind not in "biufc":
        raise InputError(f"{name}: numbers were expected, not an array of {array.dtype}")
    if array.dtype.kind == "c" and array.dtype.itemsize > 8:
        warn_of_precision(f"{name}: {array.dtype} is converted to complex64, which rounds to 6e-8", stacklevel + 1)
    return np.ascontiguousarray(array, dtype=np.complex64)


def float32(values: ArrayLike, name: str, stacklevel: int = 2) -> NDArray[np.float32]:
    """Numbers as contiguous float32; says so where that loses precision."""
    import numpy as np

    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name}: real numbers were expected, not an array of {array.dtype}")
    if array.dtype.kind == "f" and array.dtype.itemsize > 4:
        warn_of_precision(f"{name}: {array.dtype} is converted to float32, which rounds to 6e-8", stacklevel + 1)
    return np.ascontiguousarray(array, dtype=np.float32)


def freeze(result: object, **values: object) -> None:
    """Sets attributes of an object that is frozen from then on."""
    for name, value in values.items():
        object.__setattr__(result, name, value)


def stepped_frequencies(start: float, stop: float, step: float) -> NDArray[np.float64]:
    """The frequencies of a stepped sweep, both ends included.

    Parameters
    ----------
    start, stop, step : float
        Hz; ``stop - start`` must be a multiple of ``step``.

    Returns
    -------
    ndarray of float64, shape (n_f,)
        Hz.

    Examples
    --------
    >>> len(stepped_frequencies(10e3, 20e3, 20.0))
    501
    """
    return _holosonar.stepped_frequencies(start, stop, step)


def rectangular_array(
    count: tuple[int, int], pitch: tuple[float, float] | float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Microphones in rows and columns, parallel to z = 0.

    Parameters
    ----------
    count : (int, int)
        Columns and rows.
    pitch : float or (float, float)
        Distance between neighbours along x and y, m.
    centre : (float, float, float)
        m.

    Returns
    -------
    ndarray of float64, shape (n_y, n_x, 3)
        Positions, m.
    """
    x, y = (pitch, pitch) if isinstance(pitch, (int, float)) else pitch
    return _holosonar.rectangular_array(count, (x, y), centre)


def spiral_array(
    count: int, extent: tuple[float, float] | float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Microphones on Vogel's spiral, each for the same area.

    Parameters
    ----------
    count : int
        Microphones.
    extent : float or (float, float)
        Width along x and y of the ellipse that they fill, m.
    centre : (float, float, float)
        m.

    Returns
    -------
    ndarray of float64, shape (n_mic, 3)
        Positions, m.
    """
    x, y = (extent, extent) if isinstance(extent, (int, float)) else extent
    return _holosonar.spiral_array(count, (x, y), centre)


def random_array(
    count: int,
    extent: tuple[float, float] | float,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    spacing: float | None = None,
    seed: int = 1,
) -> NDArray[np.float64]:
    """Microphones anywhere in a rectangle, no two closer than ``spacing`` m.

    Parameters
    ----------
    count : int
        Microphones.
    extent : float or (float, float)
        Sides of the rectangle, m.
    centre : (float, float, float)
        m.
    spacing : float, optional
        m; by default half the pitch of a square lattice of the same density.
    seed : int
        The same seed gives the same positions.

    Returns
    -------
    ndarray of float64, shape (n_mic, 3)
        Positions, m.
    """
    x, y = (extent, extent) if isinstance(extent, (int, float)) else extent
    return _holosonar.random_array(count, (x, y), centre, spacing, seed)


def read_array(path: PathLike) -> NDArray[np.float64]:
    """Reads positions of microphones: Acoular's XML, or CSV with columns x, y, z in m.

    Returns
    -------
    ndarray of float64, shape (n_mic, 3)
        Positions, m.

    Raises
    ------
    InputError, NotFoundError
    """
    return _holosonar.read_array(os.fspath(path))


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Instrument:
    """How a measurement is made: frequencies, microphones, loudspeaker, detection and the speed of sound.

    Axes are right-handed: x to the right, y down, z from the array into the scene, m.

    Parameters
    ----------
    frequencies : array_like, shape (n_f,)
        Hz, ascending; even spacing is recognised but not required.
    mic_positions : array_like, shape (n_mic, 3) or (n_y, n_x, 3)
        m. Rows and columns that form a lattice are recognised.
    sound_speed : float
        m/s.
    geometry : {"fixed-source", "monostatic", "pair"}
        A loudspeaker at ``source`` or several at ``sources``, one that moves with the microphone, or one for each microphone.
    source : (float, float, float)
        Position of the loudspeaker, m.
    detection : {"quadrature", "in-phase"}
        Complex samples, or real ones.
    sources : array_like, optional
        Positions of several loudspeakers that sound one after another, shape (n_tx, 3), m; or, of the geometry "pair", that
        of each microphone, of the shape of ``mic_positions``.

    Examples
    --------
    >>> instrument = Instrument(stepped_frequencies(10e3, 20e3, 50.0), rectangular_array((32, 32), 0.02))
    >>> instrument.shape
    (201, 32, 32)
    """

    frequencies: NDArray[np.float64]
    mic_positions: NDArray[np.float64]
    sound_speed: float
    geometry: Geometry
    source: tuple[float, float, float]
    detection: Detection
    sources: NDArray[np.float64] | None

    def __init__(
        self,
        frequencies: ArrayLike,
        mic_positions: ArrayLike,
        sound_speed: float = 343.0,
        geometry: Geometry = "fixed-source",
        source: tuple[float, float, float] = (0.0, 0.0, 0.0),
        detection: Detection = "quadrature",
        sources: ArrayLike | None = None,
    ) -> None:
        x, y, z = source
        several = None if sources is None else float64(sources, "sources", 3)
        if several is not None and geometry == "fixed-source" and several.shape[:-1] == (1,):
            (x, y, z), several = several[0], None
        freeze(
            self,
            frequencies=float64(frequencies, "frequencies"),
            mic_positions=float64(mic_positions, "mic_positions", 3),
            sound_speed=float(sound_speed),
            geometry=geometry,
            source=(float(x), float(y), float(z)),
            detection=detection,
            sources=several,
        )
        _holosonar.advised_pitch(self, 1.0)  # checks everything

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the samples: (n_f, n_y, n_x) or (n_f, n_mic); of several loudspeakers n_tx before these."""
        one = (len(self.frequencies), *self.mic_positions.shape[:-1])
        return one if self.speakers == 1 else (self.speakers, *one)

    @property
    def speakers(self) -> int:
        """Loudspeakers that sound one after another; 1 of a scan or of pairs."""
        return 1 if self.sources is None or self.geometry == "pair" else len(self.sources)

    @property
    def bandwidth(self) -> float:
        """B, Hz."""
        return float(self.frequencies[-1] - self.frequencies[0])

    @property
    def range_resolution(self) -> float | None:
        """c/2B, m; ``None`` for a single frequency."""
        return self.sound_speed / (2.0 * self.bandwidth) if self.bandwidth > 0 else None

    def advised_pitch(self, nearest_z: float) -> tuple[float, float, float]:
        """Pitch of voxels along x, y and z, m, that loses little from the depth ``nearest_z`` (m) on."""
        x, y, z = _holosonar.advised_pitch(self, nearest_z)
        return (x, y, z)

    def __repr__(self) -> str:
        f, mics = self.frequencies, self.mic_positions.shape[:-1]
        count = " x ".join(str(n) for n in mics)
        speakers = "" if self.speakers == 1 else f"{self.speakers} loudspeakers, "
        return (
            f"<Instrument {len(f)} frequencies {f[0] / 1e3:g} to {f[-1] / 1e3:g} kHz, {count} microphones, {speakers}"
            f"{self.geometry}, {self.detection}, {self.sound_speed:g} m/s>"
        )


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Reflectors:
    """Point reflectors.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        m.
    amplitudes : array_like, shape (n,), optional
        Complex; 1 by default.
    """

    positions: NDArray[np.float64]
    amplitudes: NDArray[np.complex64]

    def __init__(self, positions: ArrayLike, amplitudes: ArrayLike | None = None) -> None:
        import numpy as np

        points = np.atleast_2d(float64(positions, "positions", 3))
        given = np.ones(len(points), np.complex64) if amplitudes is None else amplitudes
        freeze(self, positions=points, amplitudes=np.atleast_1d(complex64(given, "amplitudes")))

    @classmethod
    def read(cls, path: PathLike) -> Reflectors:
        """Reads a list of reflectors (.csv)."""
        return cls(*_holosonar.read_reflectors(os.fspath(path)))

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"<Reflectors {len(self)}>"


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Cube:
    """A data cube m(f, r): samples and the instrument that measured them.

    Parameters
    ----------
    samples : array_like, shape (n_f, n_y, n_x) or (n_f, n_mic), of several loudspeakers n_tx before these
        complex64 in quadrature, float32 in phase. Arrays of these types that are contiguous are kept as they are, without
        a copy; any others are converted, and a :class:`PrecisionWarning` says so where that rounds.
    instrument : Instrument
    phase_sign : {1, -1}
        -1 for samples whose phase falls with the path length, exp(-i 2 pi f path / c); they are conjugated.

    Raises
    ------
    InputError
        Samples whose shape is not the instrument's.
    """

    samples: NDArray[Any]
    instrument: Instrument
    _provenance: str | None

    def __init__(self, samples: ArrayLike, instrument: Instrument, phase_sign: int = 1) -> None:
        import numpy as np

        held: NDArray[Any]
        if instrument.detection == "quadrature":
            held = complex64(samples, "samples")
        else:
            held = float32(samples, "samples")
        expected = instrument.shape
        if held.shape != expected:
            before = 1 if instrument.speakers == 1 else 2
            flat = (*expected[:before], int(np.prod(expected[before:])))
            if held.shape != flat:
                raise InputError(
                    f"samples: have the shape {list(held.shape)}; the instrument's frequencies and microphones need "
                    f"{list(expected)}"
                )
            held = held.reshape(expected)
        if phase_sign not in (1, -1):
            raise InputError(f"phase_sign: must be 1 or -1, not {phase_sign!r}")
        freeze(self, samples=held.conj() if phase_sign < 0 else held, instrument=instrument, _provenance=None)

    @classmethod
    def read(cls, path: PathLike) -> Cube:
        """Reads a cube file; see :func:`read_cube`."""
        return _cube(_holosonar.read_cube(os.fspath(path)))

    def write(self, path: PathLike) -> None:
        """Writes a cube file (.npz or .zarr), the same bytes as the command line; it appears complete or not at all.

        Raises
        ------
        InputError
            Another extension.
        SystemFailure
            A file that cannot be written.
        """
        _holosonar.write_cube(os.fspath(path), self.samples, self.instrument, self._provenance)

    @property
    def provenance(self) -> Any:
        """Where a simulated cube is from: its run file and seed; ``None`` for a measurement."""
        return None if self._provenance is None else json.loads(self._provenance)

    @property
    def shape(self) -> tuple[int, ...]:
        """(n_f, n_y, n_x) or (n_f, n_mic); of several loudspeakers n_tx before these."""
        return self.samples.shape

    def to_xarray(self) -> xarray.DataArray:
        """The samples as an ``xarray.DataArray`` with coordinates and units; nothing is copied.

        Returns
        -------
        xarray.DataArray
            With the dimensions ``frequency`` (Hz), ``y`` and ``x`` (m) for a lattice, or ``frequency`` and ``microphone``
            with ``x``, ``y`` and ``z`` of each; of several loudspeakers ``speaker`` before these.
        """
        import xarray

        i = self.instrument
        positions, metre = i.mic_positions, {"units": "m"}
        coords: dict[str, Any] = {"frequency": ("frequency", i.frequencies, {"units": "Hz"})}
        if positions.ndim == 3:
            coords["x"] = ("x", positions[0, :, 0], metre)
            coords["y"] = ("y", positions[:, 0, 1], metre)
            dims: tuple[str, ...] = ("frequency", "y", "x")
        else:
            coords |= {name: ("microphone", positions[:, axis], metre) for axis, name in enumerate("xyz")}
            dims = ("frequency", "microphone")
        if i.sources is not None and i.speakers > 1:
            coords |= {f"source_{name}": ("speaker", i.sources[:, axis], metre) for axis, name in enumerate("xyz")}
            dims = ("speaker", *dims)
        attrs: dict[str, Any] = {
            "long_name": "m(f, r)",
            "sound_speed": i.sound_speed,
            "geometry": i.geometry,
            "source": list(i.source),
            "detection": i.detection,
        }
        return xarray.DataArray(self.samples, dims=dims, coords=coords, attrs=attrs, name="samples")

    def __repr__(self) -> str:
        return f"<Cube {' x '.join(str(n) for n in self.shape)} {self.samples.dtype}, {self.instrument!r}>"


def _cube(parts: _holosonar.CubeParts) -> Cube:
    instrument = Instrument(
        parts["frequencies"],
        parts["mic_positions"],
        parts["sound_speed"],
        parts["geometry"],
        parts["source"],
        parts["detection"],
        parts["sources"],
    )
    cube = Cube(parts["samples"], instrument)
    freeze(cube, _provenance=parts["provenance"])
    return cube


def read_cube(path: PathLike) -> Cube:
    """Reads a data cube (.npz or .zarr), measured or simulated.

    Parameters
    ----------
    path : path
        An archive or a Zarr store of ``samples``, ``frequencies``, ``mic_positions`` and, optionally, ``meta``.

    Returns
    -------
    Cube

    Raises
    ------
    InputError
        Arrays that are missing or inconsistent; the message names them.
    NotFoundError
        No such file.
    OutOfMemoryError
        A file that does not fit in memory.
    """
    return Cube.read(path)


@overload
def simulate(
    scene: RunFile | PathLike,
    instrument: None = None,
    *,
    set: Settings = None,
    memory: int | str | None = None,
    progress: Progress = None,
) -> Cube: ...


@overload
def simulate(
    scene: Reflectors,
    instrument: Instrument,
    *,
    snr_db: float | None = None,
    seed: int | None = None,
    spreading: bool | None = None,
    tolerance: float | None = None,
    set: Settings = None,
    progress: Progress = None,
) -> Cube: ...


def simulate(
    scene: Reflectors | RunFile | PathLike,
    instrument: Instrument | None = None,
    *,
    snr_db: float | None = None,
    seed: int | None = None,
    spreading: bool | None = None,
    tolerance: float | None = None,
    set: Settings = None,
    memory: int | str | None = None,
    progress: Progress = None,
) -> Cube:
    """Simulates the data cube of a scene: m(f, r) = sum of A exp(+i 2 pi f path(r) / c) over its reflectors.

    Parameters
    ----------
    scene : RunFile, path or Reflectors
        A run file, a mesh, or a list of reflectors (.csv), which come with their instrument; or reflectors.
    instrument : Instrument
        For :class:`Reflectors`.
    snr_db : float, optional
        Adds noise this far below the rms of the samples, dB.
    seed : int, optional
        Of the noise, and of the phases of a scene's surfaces.
    spreading : bool, optional
        Whether echoes decay with distance.
    tolerance : float, optional
        Maximum error relative to the sum of all amplitudes; 0 sums every term. 1e-6 by default.
    set : mapping or list of str, optional
        Any keys of the run file, as in ``{"medium.absorption": True}``.
    memory : int or str, optional
        Most memory, bytes or as in ``"2GiB"``; 80 % of what is free by default. For scenes.
    progress : bool, tqdm or callable, optional
        Reports the progress; see :data:`Progress`.

    Returns
    -------
    Cube
        Of shape (n_f, n_y, n_x) or (n_f, n_mic). The same for any number of threads, and for a scene the same bytes as
        ``holosonar simulate`` writes.

    Raises
    ------
    InputError
        Values that are not possible; the message names the key.
    OutOfMemoryError
        A cube that does not fit in memory.
    KeyboardInterrupt
        On Ctrl-C, at once.

    Examples
    --------
    >>> instrument = Instrument(stepped_frequencies(10e3, 12e3, 500.0), rectangular_array((4, 3), 0.05))
    >>> simulate(Reflectors([(0.0, 0.0, 1.0)]), instrument).shape
    (5, 3, 4)
    """
    settings = typed(
        set,
        detection__snr_db=snr_db,
        reflectors__seed=seed,
        medium__spreading=spreading,
        detection__tolerance=tolerance,
    )
    with reporting(progress) as callback:
        if isinstance(scene, Reflectors):
            if instrument is None:
                raise InputError("instrument: is needed for reflectors")
            run = run_of(None, settings)
            points = (scene.positions, scene.amplitudes)
            return Cube(_holosonar.simulate_points(*points, instrument, run, callback), instrument)
        if instrument is not None:
            raise InputError("instrument: is that of the run file; change it with set, as in {'sweep.step': 40}")
        run = run_of(scene, settings)
        return _cube(_holosonar.simulate_scene(run, size(memory), callback))


def size(memory: int | str | None) -> str | None:
    """A size of memory as text."""
    return None if memory is None else str(memory)
