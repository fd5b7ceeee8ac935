"""Grids and volumes; reconstruction."""

from __future__ import annotations

import base64
import html
import json
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from . import _holosonar
from ._cubes import Cube, Instrument, complex64, freeze, read_cube, size
from ._errors import InputError
from ._progress import Progress, reporting
from ._run_file import PathLike, RunFile, Settings, run_of, typed

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from numpy.typing import ArrayLike, NDArray

Method = Literal["auto", "convolution", "backprojection", "direct", "linear", "correlation"]
Window = Literal["none", "hann", "taylor"]


@dataclass(frozen=True)
class Axis:
    """Evenly spaced centres along one axis.

    Parameters
    ----------
    first : float
        Centre of the first voxel, m.
    pitch : float
        Distance between neighbours, m.
    count : int
        Voxels, at least 1.
    """

    first: float
    pitch: float
    count: int

    @classmethod
    def spanning(cls, first: float, last: float, pitch: float) -> Axis:
        """From ``first`` to the last centre that does not exceed ``last``, m."""
        if not (pitch > 0 and last >= first):
            raise InputError(f"axis: needs first <= last and a positive pitch, not {first} .. {last} m by {pitch} m")
        return cls(float(first), float(pitch), int((last - first) / pitch + 1e-6) + 1)

    @property
    def last(self) -> float:
        """Centre of the last voxel, m."""
        return self.first + self.pitch * (self.count - 1)

    @property
    def positions(self) -> NDArray[np.float64]:
        """All centres, m."""
        import numpy as np

        return np.asarray(self.first + self.pitch * np.arange(self.count), dtype=np.float64)

    def __len__(self) -> int:
        return self.count


@dataclass(frozen=True)
class Grid:
    """A box of voxels.

    Parameters
    ----------
    x, y, z : Axis
        Columns to the right, rows downwards, depths away from the array.

    Examples
    --------
    >>> Grid.spanning(x=(-0.5, 0.5), y=(-0.5, 0.5), z=(1.0, 2.0), pitch=0.01).shape
    (101, 101, 101)
    """

    x: Axis
    y: Axis
    z: Axis

    @classmethod
    def spanning(
        cls,
        x: tuple[float, float],
        y: tuple[float, float],
        z: tuple[float, float],
        pitch: float | tuple[float, float, float] | Instrument,
    ) -> Grid:
        """A grid from its first and last voxels.

        Parameters
        ----------
        x, y, z : (float, float)
            First and last centre along each axis, m.
        pitch : float, (float, float, float) or Instrument
            m, along x, y and z; or an instrument, whose resolution it then suits.
        """
        if isinstance(pitch, Instrument):
            pitch = pitch.advised_pitch(z[0])
        dx, dy, dz = (pitch, pitch, pitch) if isinstance(pitch, (int, float)) else pitch
        return cls(Axis.spanning(*x, dx), Axis.spanning(*y, dy), Axis.spanning(*z, dz))

    @property
    def shape(self) -> tuple[int, int, int]:
        """(n_z, n_y, n_x)."""
        return (self.z.count, self.y.count, self.x.count)

    def __repr__(self) -> str:
        sides = (f"{name} {a.first:g} to {a.last:g} m ({a.count})" for name, a in zip("xyz", (self.x, self.y, self.z)))
        return f"<Grid {', '.join(sides)}>"


def picture(png: bytes, text: str) -> str:
    """A picture with a caption, for notebooks."""
    data = base64.b64encode(png).decode("ascii")
    return f'<figure><img style="max-width:100%" src="data:image/png;base64,{data}"><figcaption>{html.escape(text)}</figcaption></figure>'


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Volume:
    """The reconstructed complex amplitude on a grid; a unit reflector on a voxel peaks at 1.

    Parameters
    ----------
    samples : array_like, shape (n_z, n_y, n_x)
        complex64; kept without a copy where it is that and contiguous.
    grid : Grid
    """

    samples: NDArray[np.complex64]
    grid: Grid
    _meta: str

    def __init__(self, samples: ArrayLike, grid: Grid) -> None:
        freeze(self, samples=complex64(samples, "samples"), grid=grid, _meta="{}")
        if self.samples.shape != self.grid.shape:
            raise InputError(
                f"samples: have the shape {list(self.samples.shape)}; the grid needs {list(self.grid.shape)}, [z, y, x]"
            )

    @classmethod
    def read(cls, path: PathLike) -> Volume:
        """Reads a volume file; see :func:`read_volume`."""
        return volume_of(_holosonar.read_volume(os.fspath(path)))

    def write(self, path: PathLike, *, run: RunFile | PathLike | None = None, set: Settings = None) -> list[str]:
        """Writes the volume: .npz, .zarr, .exr, .vti, .nrrd or .vdb, by extension.

        Parameters
        ----------
        path : path
        run : RunFile or path, optional
            Its ``[output]`` is used.
        set : mapping or list of str, optional
            As in ``{"output.components": "complex"}``.

        Returns
        -------
        list of str
            The files written; a very deep volume takes several .exr files.
        """
        options = run_of(run, typed(set))
        files = _holosonar.write_volume(os.fspath(path), self.samples, self.grid, self._meta, options)
        return [os.fspath(file) for file in files]

    @property
    def amplitude(self) -> NDArray[np.float32]:
        """The absolute values, (n_z, n_y, n_x)."""
        import numpy as np

        return np.abs(self.samples)

    @property
    def meta(self) -> Any:
        """How it was measured and computed: instrument, method, window, error bound, run file."""
        return json.loads(self._meta)

    def to_xarray(self) -> xarray.DataArray:
        """The samples as an ``xarray.DataArray`` with the dimensions ``z``, ``y`` and ``x``, m; nothing is copied."""
        import xarray

        axes = {"z": self.grid.z, "y": self.grid.y, "x": self.grid.x}
        coords = {name: (name, axis.positions, {"units": "m"}) for name, axis in axes.items()}
        facts = {key: value for key, value in self.meta.items() if isinstance(value, (int, float, str))}
        attrs = {"long_name": "reconstructed amplitude", **facts}
        return xarray.DataArray(self.samples, dims=("z", "y", "x"), coords=coords, attrs=attrs, name="amplitude")

    def picture(self) -> bytes:
        """The amplitude from the front and from above, dB below the peak, as a PNG: ``amplitude.png`` of ``image``."""
        return _holosonar.amplitude_picture(self.samples, self.grid)

    def _repr_html_(self) -> str:
        return picture(self.picture(), repr(self))

    def __repr__(self) -> str:
        z, y, x = self.grid.shape
        return f"<Volume {x} x {y} x {z} voxels, {self.grid!r}>"


def volume_of(parts: _holosonar.VolumeParts) -> Volume:
    """A volume from its parts."""
    grid = Grid(Axis(*parts["x"]), Axis(*parts["y"]), Axis(*parts["z"]))
    volume = Volume(parts["samples"], grid)
    freeze(volume, _meta=parts["meta"])
    return volume


def read_volume(path: PathLike) -> Volume:
    """Reads a volume (.npz or .zarr).

    Raises
    ------
    InputError
        Arrays that are missing or inconsistent, or an uneven axis; the message names the array.
    NotFoundError
        No such file.
    """
    return Volume.read(path)


def reconstruct(
    cube: Cube | PathLike,
    grid: Grid | None = None,
    *,
    run: RunFile | PathLike | None = None,
    method: Method | None = None,
    window: Window | None = None,
    tolerance: float | None = None,
    compensate: bool | None = None,
    sub_band: int | None = None,
    set: Settings = None,
    memory: int | str | None = None,
    progress: Progress = None,
) -> Volume:
    """Reconstructs the volume that a cube shows: the sum over all frequencies and microphones of Eq. 13, at FFT speed.

    Parameters
    ----------
    cube : Cube or path
    grid : Grid, optional
        By default that of the run file.
    run : RunFile or path, optional
        Its ``[calibration]``, ``[grid]``, ``[reconstruct]`` and ``[refine]`` are used.
    method : {"auto", "convolution", "backprojection", "direct", "linear", "correlation"}, optional
        How the sum is carried out; ``direct`` is the literal sum, on any grid and for any microphones. ``correlation`` is
        another image, of the phases between pairs of microphones, which needs none of the loudspeaker's.
    window : {"taylor", "hann", "none"}, optional
        Weights over array and band.
    tolerance : float, optional
        Error allowed to fast methods, relative to the largest amplitude that the samples could give; 1e-4 by default.
    compensate : bool, optional
        Whether to undo spherical spreading.
    sub_band : int, optional
        Of ``correlation``: the tones within which the loudspeaker's phases are trusted; by default 1.
    set : mapping or list of str, optional
        Any keys of the run file, as in ``{"refine.method": "fista"}``.
    memory : int or str, optional
        Most memory, bytes or as in ``"2GiB"``; it changes no byte of the volume.
    progress : bool, tqdm or callable, optional
        Reports the progress; see :data:`Progress`.

    Returns
    -------
    Volume
        (n_z, n_y, n_x), complex64; the same bytes as of ``holosonar reconstruct`` with the same run file.

    Raises
    ------
    InputError
        No grid; samples that are not finite; a method that is not possible.
    OutOfMemoryError
        A job that does not fit in memory; the message says what would.
    KeyboardInterrupt
        On Ctrl-C.

    Examples
    --------
    >>> instrument = Instrument(stepped_frequencies(10e3, 14e3, 100.0), rectangular_array((11, 11), 0.03))
    >>> cube = simulate(Reflectors([(0.03, -0.06, 0.8)]), instrument)
    >>> grid = Grid.spanning(x=(-0.15, 0.15), y=(-0.15, 0.15), z=(0.7, 0.9), pitch=(0.03, 0.03, 0.02))
    >>> volume = reconstruct(cube, grid)
    >>> bool(abs(volume.samples[5, 3, 6]) > 0.99)
    True
    """
    settings = typed(
        set,
        reconstruct__method=method,
        reconstruct__window=window,
        reconstruct__tolerance=tolerance,
        reconstruct__compensate=compensate,
        reconstruct__sub_band=sub_band,
    )
    with reporting(progress) as callback:
        cube = cube if isinstance(cube, Cube) else read_cube(cube)
        options = run_of(run, settings)
        return volume_of(
            _holosonar.reconstruct(cube.samples, cube.instrument, grid, options, size(memory), callback)
        )
