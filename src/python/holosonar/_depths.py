"""Depth maps: located in volumes, traced in scenes, read, written and compared."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from . import _holosonar
from ._cubes import float32, freeze
from ._errors import InputError
from ._progress import Progress, reporting
from ._run_file import PathLike, RunFile, Settings, run_of, typed
from ._volumes import Axis, Volume, picture, read_volume

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from numpy.typing import ArrayLike, NDArray

View = Literal["orthographic", "perspective"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class DepthLayer:
    """One surface per pixel; every map is (n_y, n_x), NaN where there is no surface.

    Parameters
    ----------
    depth : array_like of float32
        Planar depth along z, m; NaN where there is nothing.
    amplitude : array_like of float32, optional
        In units of the volume; 0 where there is nothing. By default 1 at every surface.
    confidence : array_like of float32, optional
        dB.
    error : array_like of float32, optional
        Standard error of the depth, m.
    normals : array_like of float32, shape (n_y, n_x, 3), optional
        Unit normals that face the array.
    facing : array_like of float32, optional
        Of a truth: distance from the surface per error in depth, the cosine to the pixel's ray.
    material : array_like of uint32, optional
        Of a truth: 1 for the first of its materials, 0 where there is nothing.
    """

    depth: NDArray[np.float32]
    amplitude: NDArray[np.float32]
    confidence: NDArray[np.float32] | None
    error: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None
    facing: NDArray[np.float32] | None
    material: NDArray[np.uint32] | None

    def __init__(
        self,
        depth: ArrayLike,
        amplitude: ArrayLike | None = None,
        confidence: ArrayLike | None = None,
        error: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        facing: ArrayLike | None = None,
        material: ArrayLike | None = None,
    ) -> None:
        import numpy as np

        z = float32(depth, "depth")
        if z.ndim != 2:
            raise InputError(f"depth: two axes (n_y, n_x) were expected, not the shape {list(z.shape)}")
        # Files and other programs mark "nothing" by an infinity.
        if np.isinf(z).any():
            z = np.where(np.isinf(z), np.float32(np.nan), z)
        maps = {"confidence": confidence, "error": error, "normals": normals, "facing": facing}
        converted = {name: None if map is None else float32(map, name) for name, map in maps.items()}
        strength = (~np.isnan(z)).astype(np.float32) if amplitude is None else float32(amplitude, "amplitude")
        kinds = None if material is None else np.ascontiguousarray(material, np.uint32)
        freeze(self, depth=z, amplitude=strength, material=kinds, **converted)
        for name in ("amplitude", "confidence", "error", "normals", "facing", "material"):
            values = getattr(self, name)
            if values is not None and values.shape[:2] != z.shape:
                raise InputError(f"{name}: has the shape {list(values.shape)}; depth has {list(z.shape)}")

    def __repr__(self) -> str:
        rows, columns = self.depth.shape
        return f"<DepthLayer {columns} x {rows} pixels>"


@dataclass(frozen=True, eq=False, repr=False)
class DepthMap:
    """Depth and amplitude per pixel: reconstructed, or the truth.

    Parameters
    ----------
    picked : DepthLayer
        The one return picked for each pixel; its arrays are attributes of the map, too.
    x, y : Axis
        Columns and rows, m; of a perspective view slopes x/z and y/z.
    returns : tuple of DepthLayer
        All accepted returns, front to back.
    view : {"orthographic", "perspective"}
    materials : list of str
        Names to which ``material`` refers from 1.
    """

    picked: DepthLayer
    x: Axis
    y: Axis
    returns: tuple[DepthLayer, ...] = ()
    view: View = "orthographic"
    materials: list[str] = field(default_factory=list)
    _meta: str = "{}"
    _truth: bool = False

    def __post_init__(self) -> None:
        shape, expected = self.picked.depth.shape, (self.y.count, self.x.count)
        if shape != expected:
            raise InputError(f"depth: has the shape {list(shape)}; the axes need {list(expected)}, [y, x]")

    @classmethod
    def read(cls, path: PathLike) -> DepthMap:
        """Reads a depth map; see :func:`read_depth`."""
        return map_of(_holosonar.read_depth(os.fspath(path)))

    def write(self, path: PathLike, *, run: RunFile | PathLike | None = None, set: Settings = None) -> None:
        """Writes the depth map as an image (.exr), or as a cloud of points with normals (.ply).

        Parameters
        ----------
        path : path
        run : RunFile or path, optional
            Its ``[output]`` and ``[depth] fill`` are used.
        set : mapping or list of str, optional
            As in ``{"depth.fill": "nan"}``.
        """
        _holosonar.write_depth(os.fspath(path), self, self._meta, run_of(run, typed(set)))

    @property
    def depth(self) -> NDArray[np.float32]:
        """Planar depth along z, m, (n_y, n_x); NaN where nothing was accepted."""
        return self.picked.depth

    @property
    def amplitude(self) -> NDArray[np.float32]:
        """Amplitude in units of the volume, (n_y, n_x); 0 where nothing was accepted."""
        return self.picked.amplitude

    @property
    def confidence(self) -> NDArray[np.float32] | None:
        """Confidence, dB, (n_y, n_x); ``None`` for a truth."""
        return self.picked.confidence

    @property
    def error(self) -> NDArray[np.float32] | None:
        """Standard error of the depth, m, (n_y, n_x), where it is known."""
        return self.picked.error

    @property
    def normals(self) -> NDArray[np.float32] | None:
        """Unit normals that face the array, (n_y, n_x, 3), where they are known."""
        return self.picked.normals

    @property
    def points(self) -> NDArray[np.float64]:
        """Position of every pixel's return, (n_y, n_x, 3), m; NaN where there is none."""
        import numpy as np

        z = self.depth.astype(np.float64)
        y, x = np.meshgrid(self.y.positions, self.x.positions, indexing="ij")
        scale = z if self.view == "perspective" else np.where(np.isnan(z), np.nan, 1.0)
        return np.stack([x * scale, y * scale, z], axis=-1)

    @property
    def range(self) -> NDArray[np.float64]:
        """Distance |p| of every pixel's return from the origin, m, (n_y, n_x)."""
        import numpy as np

        ranges: NDArray[np.float64] = np.linalg.norm(self.points, axis=-1)
        return ranges

    @property
    def accepted(self) -> int:
        """Pixels with a return."""
        import numpy as np

        return int(np.count_nonzero(~np.isnan(self.depth)))

    @property
    def meta(self) -> Any:
        """How it was measured and computed."""
        return json.loads(self._meta)

    def to_xarray(self) -> xarray.Dataset:
        """The maps as an ``xarray.Dataset`` over ``y`` and ``x``, with units; normals also over ``component``."""
        import xarray

        unit = "m" if self.view == "orthographic" else "1"
        coords = {name: (name, axis.positions, {"units": unit}) for name, axis in (("y", self.y), ("x", self.x))}
        units = {"depth": "m", "amplitude": "1", "confidence": "dB", "error": "m"}
        maps: dict[str, Any] = {}
        for name, each in units.items():
            values = getattr(self, name)
            if values is not None:
                maps[name] = (("y", "x"), values, {"units": each})
        maps["range"] = (("y", "x"), self.range, {"units": "m"})
        if self.normals is not None:
            maps["normals"] = (("y", "x", "component"), self.normals, {"units": "1"})
        for number, layer in enumerate(self.returns, 1):
            maps[f"return{number}"] = (("y", "x"), layer.depth, {"units": "m"})
        facts = {key: value for key, value in self.meta.items() if isinstance(value, (int, float, str))}
        return xarray.Dataset(maps, coords=coords, attrs={"view": self.view, **facts})

    def picture(self) -> bytes:
        """The depth as a PNG: ``depth.png`` of ``image``, in its own range of colours."""
        return _holosonar.depth_picture(self, self._truth)

    def _repr_html_(self) -> str:
        return picture(self.picture(), repr(self))

    def __repr__(self) -> str:
        rows, columns = self.depth.shape
        kind = "true depth" if self._truth else "depth"
        return f"<DepthMap {columns} x {rows} pixels, {kind} at {self.accepted} of them>"


def map_of(parts: _holosonar.DepthParts, truth: bool = False) -> DepthMap:
    """A depth map from its parts."""
    returns = tuple(DepthLayer(**layer) for layer in parts["returns"])
    return DepthMap(
        DepthLayer(**parts["picked"]),
        Axis(*parts["x"]),
        Axis(*parts["y"]),
        returns,
        parts["view"],
        parts["materials"],
        parts["meta"],
        truth,
    )


def read_depth(path: PathLike) -> DepthMap:
    """Reads a depth map (.exr) of this program, or any with a channel ``Z``.

    Returns
    -------
    DepthMap
        NaN where the file has no return. Without coordinates, as in files of other programs, the axes count pixels.
    """
    return DepthMap.read(path)


def locate_depth(
    volume: Volume | PathLike,
    *,
    run: RunFile | PathLike | None = None,
    refine: Literal["surface", "column", "parabola", "none"] | None = None,
    pick: Literal["strongest", "first"] | None = None,
    confidence_db: float | None = None,
    returns: int | None = None,
    set: Settings = None,
    progress: Progress = None,
) -> DepthMap:
    """Locates depth in a volume: for every pixel a depth, an amplitude, a confidence, a normal and further returns.

    Parameters
    ----------
    volume : Volume or path
    run : RunFile or path, optional
        Its ``[depth]`` is used, and its ``[sweep]`` if the volume does not know its bandwidth.
    refine : {"surface", "column", "parabola", "none"}, optional
        How depth follows from the power around a peak.
    pick : {"strongest", "first"}, optional
        Which return is a pixel's depth.
    confidence_db : float, optional
        Minimum confidence of a surface, dB.
    returns : int, optional
        Maximum number of surfaces per pixel.
    set : mapping or list of str, optional
        Any keys of the run file, as in ``{"depth.gate": False}``.
    progress : bool, tqdm or callable, optional
        Reports the progress; see :data:`Progress`.

    Returns
    -------
    DepthMap
        (n_y, n_x); the same bytes as of ``holosonar depth``.

    Raises
    ------
    InputError
        A volume without bandwidth, or options that are not possible.
    """
    volume = volume if isinstance(volume, Volume) else read_volume(volume)
    settings = typed(
        set, depth__refine=refine, depth__pick=pick, depth__confidence_db=confidence_db, depth__returns=returns
    )
    options = run_of(run, settings)
    with reporting(progress) as callback:
        parts = _holosonar.locate_depth(
            volume.samples, volume.grid, volume._meta, options, run is not None, callback
        )
    return map_of(parts)


def truth(run: RunFile | PathLike, *, set: Settings = None, progress: Progress = None) -> DepthMap:
    """The true depth map of a scene, ray-cast on the pixels of its depth map; nothing is simulated.

    Parameters
    ----------
    run : RunFile or path
        A run file or a mesh.
    set : mapping or list of str, optional
        Keys of the run file.
    progress : bool, tqdm or callable, optional

    Returns
    -------
    DepthMap
        With ``facing`` and ``material`` of its surfaces.
    """
    with reporting(progress) as callback:
        return map_of(_holosonar.truth(run_of(run, typed(set)), callback), True)


@dataclass(frozen=True, repr=False)
class Scores:
    """The metrics of a depth map against a truth.

    Attributes
    ----------
    metrics : dict
        Over all pixels, by name: shares of 1, lengths in m; ``None`` where there was nothing to measure on.
    materials : dict
        The same for the surfaces of each material, by name.
    surfaces : list of dict
        The same for each pixel's first surface from the front, its second, and so on.
    """

    metrics: dict[str, float | None]
    materials: dict[str, dict[str, float | None]]
    surfaces: list[dict[str, float | None]]

    def __getitem__(self, name: str) -> float | None:
        """The metric of that name over all pixels."""
        return self.metrics[name]

    def __repr__(self) -> str:
        known = (f"{name}={value:.4g}" for name, value in self.metrics.items() if value is not None)
        return f"<Scores {', '.join(known)}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{name}</td><td>{value:.4g}</td></tr>"
            for name, value in self.metrics.items()
            if value is not None
        )
        return f"<table>{rows}</table>"


def compare(found: DepthMap | PathLike, truth: DepthMap | PathLike, *, resolution: float | None = None) -> Scores:
    """Scores a depth map against a truth.

    Parameters
    ----------
    found, truth : DepthMap or path
        On the same pixels.
    resolution : float, optional
        Range resolution c/2B, m, which decides what is a hit; by default from the metadata of either.

    Returns
    -------
    Scores

    Raises
    ------
    InputError
        Pixels that do not coincide; a resolution that is not known.

    Examples
    --------
    >>> import numpy as np
    >>> axes = (Axis(0.0, 0.01, 3), Axis(0.0, 0.01, 1))
    >>> found = DepthMap(DepthLayer(np.float32([[1.001, 2.0, 1.4]])), *axes)
    >>> true = DepthMap(DepthLayer(np.float32([[1.0, 2.0, 1.5]])), *axes)
    >>> round(compare(found, true, resolution=0.017)["completeness"], 3)
    0.667
    """
    found = found if isinstance(found, DepthMap) else read_depth(found)
    truth = truth if isinstance(truth, DepthMap) else read_depth(truth)
    scores = json.loads(_holosonar.compare(found, truth, (truth._meta, found._meta), resolution))
    return Scores(scores["all"], scores["materials"], scores["surfaces"])


def error_picture(found: DepthMap, truth: DepthMap, *, resolution: float | None = None) -> bytes:
    """The depth error, found minus true, as a PNG.

    Parameters
    ----------
    found, truth : DepthMap
        On the same pixels.
    resolution : float, optional
        c/2B, m: the colours reach twice as far at the most; by default from the metadata.
    """
    known = [meta.get("range_resolution") for meta in (truth.meta, found.meta)]
    width = resolution or next((value for value in known if value), float("nan"))
    return _holosonar.error_picture(found, truth, width, "")
