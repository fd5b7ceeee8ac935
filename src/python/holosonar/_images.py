"""The main job: from a scene or a cube to volume, depth map, truth and scores."""

from __future__ import annotations

import html
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

from . import _holosonar
from ._cubes import Cube, size
from ._depths import DepthMap, Scores, map_of
from ._errors import InputError
from ._progress import Progress, reporting
from ._run_file import PathLike, RunFile, Settings, run_of, typed
from ._volumes import Grid, Volume, volume_of


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """Everything that one job computed.

    Attributes
    ----------
    volume : Volume
    depth : DepthMap
    truth : DepthMap or None
        Of a scene with surfaces.
    scores : Scores or None
        The depth map against the truth.
    report : dict
        As in ``report.json``: the run file with every default, plan, method, error bound, warnings, timings in s.
    files : list of Path
        Files written.
    """

    volume: Volume
    depth: DepthMap
    truth: DepthMap | None
    report: dict[str, Any]
    files: list[Path]

    @property
    def scores(self) -> Scores | None:
        """The depth map against the truth; ``None`` without one."""
        report = self.report
        if report["metrics"] is None:
            return None
        return Scores(report["metrics"], report["materials"], report["surfaces"])

    def __repr__(self) -> str:
        scores = "" if self.scores is None else f", {self.scores!r}"
        return f"<Image {self.volume!r}, {self.depth!r}{scores}>"

    def _repr_html_(self) -> str:
        parts = [self.volume._repr_html_(), self.depth._repr_html_()]
        parts += [part._repr_html_() for part in (self.truth, self.scores) if part is not None]
        return "".join(parts)


def _image(parts: _holosonar.ImageParts, output: PathLike | None) -> Image:
    truth = parts["truth"]
    folder = Path(os.fspath(output)) if output is not None else Path()
    return Image(
        volume_of(parts["volume"]),
        map_of(parts["depth"]),
        None if truth is None else map_of(truth, True),
        json.loads(parts["report"]),
        [folder / file for file in parts["files"]],
    )


def image(
    scene: RunFile | Cube | PathLike,
    *,
    output: PathLike | None = None,
    grid: Grid | None = None,
    run: RunFile | PathLike | None = None,
    set: Settings = None,
    memory: int | str | None = None,
    progress: Progress = None,
) -> Image:
    """Images a scene or a measured cube: simulates, reconstructs, locates depth, and scores it where there is a truth.

    Parameters
    ----------
    scene : RunFile, Cube or path
        A run file, a mesh or a list of reflectors (.csv); or a cube, or the file of one (.npz or .zarr).
    output : path, optional
        A folder for the files that ``holosonar image -o`` writes, with the same bytes. Finished blocks are stored there,
        too: if the job is interrupted, the same call, or the same command, goes on from them.
    grid : Grid, optional
        For a :class:`Cube`.
    run : RunFile or path, optional
        For a cube: its ``[calibration]``, ``[grid]``, ``[reconstruct]``, ``[refine]``, ``[depth]`` and ``[output]``.
    set : mapping or list of str, optional
        Keys of the run file: ``{"sweep.step": 40}`` or ``["sweep.step=40"]``.
    memory : int or str, optional
        Most memory, bytes or as in ``"2GiB"``; it changes no result.
    progress : bool, tqdm or callable, optional
        Reports the progress; see :data:`Progress`.

    Returns
    -------
    Image

    Raises
    ------
    InputError, NotFoundError, OutOfMemoryError, SystemFailure
    KeyboardInterrupt
        On Ctrl-C.
    """
    folder = None if output is None else os.fspath(output)
    settings, limit = typed(set), size(memory)
    with reporting(progress) as callback:
        if isinstance(scene, Cube):
            options = run_of(run, settings)
            parts = _holosonar.image_samples(
                scene.samples, scene.instrument, grid, options, folder, limit, callback
            )
            return _image(parts, output)
        if grid is not None:
            raise InputError("grid: is for a Cube; for a scene or a file, set grid.x, grid.y, grid.z and grid.pitch")
        if _is_cube(scene):
            options = run_of(run, settings)
            return _image(_holosonar.image_file(os.fspath(scene), options, folder, limit, callback), output)
        if run is not None:
            raise InputError("run: is for a cube; the run file of a scene is the first argument")
        return _image(_holosonar.image_scene(run_of(scene, settings), folder, limit, callback), output)


def _is_cube(scene: RunFile | PathLike) -> TypeGuard[PathLike]:
    return not isinstance(scene, RunFile) and os.fspath(scene).lower().endswith((".npz", ".zarr"))


class Plan(Mapping[str, Any]):
    """What a job will resolve, alias, need and write: the content of ``holosonar plan --json``; ``print`` shows it.

    Keys are, among others, ``plan`` (resolutions in m), ``design`` (widths and sidelobes), ``methods`` with their
    operations and bytes, ``memory``, ``seconds``, ``files`` and ``warnings``.
    """

    def __init__(self, content: dict[str, Any], text: str) -> None:
        self._content, self._text = content, text

    def __getitem__(self, key: str) -> Any:
        return self._content[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)

    @property
    def warnings(self) -> list[str]:
        """What is likely to be wrong, and how to fix it."""
        warnings: list[str] = self._content["warnings"]
        return warnings

    @property
    def range_resolution(self) -> float | None:
        """c/2B, m."""
        resolution: float | None = self._content["plan"]["range_resolution"]
        return resolution

    @property
    def peak_memory(self) -> int:
        """Most memory of ``image``, bytes."""
        return int(self._content["memory"][0]["bytes"])

    @property
    def seconds(self) -> float:
        """Seconds of the reconstruction, from a short measurement of this computer's speed."""
        return float(self._content["seconds"][self._content["chosen"]])

    def __str__(self) -> str:
        return self._text

    def __repr__(self) -> str:
        return f"<Plan {len(self.warnings)} warnings, {self.peak_memory / 2**20:.0f} MiB, {self.seconds:.2g} s>"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self._text)}</pre>"


def plan(
    scene: RunFile | PathLike,
    *,
    run: RunFile | PathLike | None = None,
    set: Settings = None,
    memory: int | str | None = None,
) -> Plan:
    """Predicts resolution, aliasing, memory, time and files of :func:`image`, in under a second.

    Parameters
    ----------
    scene : RunFile or path
        A run file, a mesh, a list of reflectors (.csv) or the file of a cube (.npz or .zarr).
    run : RunFile or path, optional
        For a cube.
    set : mapping or list of str, optional
        Keys of the run file.
    memory : int or str, optional
        Most memory, bytes or as in ``"2GiB"``.

    Returns
    -------
    Plan
    """
    cube = os.fspath(scene) if _is_cube(scene) else None
    options = run_of(run if cube is not None else scene, typed(set))
    content, text = _holosonar.plan(options, cube, size(memory))
    return Plan(json.loads(content), text)


def plan_sweep(
    run: RunFile | PathLike,
    keys: Mapping[str, Any],
    *,
    set: Settings = None,
    simulate: bool = False,
    seeds: Sequence[int] = (),
    measure: str = "chamfer_distance",
    output: PathLike | None = None,
    memory: int | str | None = None,
    progress: Progress = None,
) -> list[dict[str, Any]]:
    """Predicts every combination of values of keys, the last key fastest; or simulates them and compares depth with the truth.

    Parameters
    ----------
    run : RunFile or path
    keys : mapping
        Lists of values by key, as in ``{"array.extent": [0.5, 1.0], "array.layout": ["grid", "spiral"]}``.
    set : mapping or list of str, optional
        Keys that are the same for all.
    simulate : bool
        Whether every combination is simulated, imaged and scored, as ``check`` does.
    seeds : sequence of int, optional
        Seeds of ``[reflectors]`` to simulate with; by default those of ``[expect]``, or the run file's own.
    measure : str
        The metric whose error is weighed against the time of the measurement and microphones.
    output : path, optional
        Folder for ``sweep.csv``, ``sweep.json`` and pictures of what is simulated. Finished combinations are kept there, and the
        next call uses them.
    memory : int or str, optional
    progress : bool, tqdm or callable, optional

    Returns
    -------
    list of dict
        One for each combination: its values by key, and ``microphones``, ``tones``, ``acquisition_seconds``, ``tone_seconds``,
        ``range_resolution`` (m), ``widths`` (m, near, middle, far), ``verdict``, ``ghost_offset`` (m), ``peak_sidelobe_db``,
        ``mean_sidelobe_db``; of a prediction ``peak_bytes`` and ``seconds``; of a simulation the mean of each metric by its
        name, its standard deviation as ``NAME_sd``, ``seeds``, ``expected`` (whether ``[expect]`` is kept), ``error``, and
        ``front``, ``front_time`` and ``front_microphones`` (whether nothing is better in error and both costs, or in error and
        one); or ``refused`` with the reason. ``pandas.DataFrame`` takes it as it is.
    """
    values = {key: [items] if isinstance(items, str) else list(items) for key, items in keys.items()}
    texts = [(key, [typed({key: item})[0].partition("=")[2] for item in items]) for key, items in values.items()]
    options = run_of(run, typed(set))
    if not simulate and (output is not None or seeds):
        raise InputError("output and seeds are of a simulation, and simulate is False")
    with reporting(progress) as callback:
        if simulate:
            folder = None if output is None else os.fspath(output)
            text = _holosonar.simulate_sweep(
                options, texts, list(seeds), measure, folder, size(memory), callback
            )
        else:
            text = _holosonar.plan_sweep(options, texts, size(memory), callback)
    combinations = _products(list(values.values()))
    found = json.loads(text)["combinations"]
    return [dict(zip(values, combination)) | _row(row) for combination, row in zip(combinations, found)]


def _row(found: dict[str, Any]) -> dict[str, Any]:
    """A combination without what is nested."""
    row: dict[str, Any] = dict(found["design"] or {})
    if time := row.pop("acquisition", None):
        row |= {"acquisition_seconds": time["seconds"]} | {key: time[key] for key in ("tone_seconds", "tone_time")}
    if scores := found.get("simulated"):
        row |= scores["mean"] | {f"{name}_sd": value for name, value in scores["spread"].items()}
        row |= {key: scores[key] for key in ("seeds", "expected", "error")}
        row |= {"front": scores["front"]["all"]}
        row |= {f"front_{key}": scores["front"][key] for key in ("time", "microphones")}
    row["refused"] = found["refused"]
    return row


def _products(values: list[list[Any]]) -> list[list[Any]]:
    """Every combination, the last fastest."""
    products: list[list[Any]] = [[]]
    for items in values:
        products = [[*product, item] for product in products for item in items]
    return products


class PointSpreads(list[dict[str, Any]]):
    """The images of points, a dict for each: ``point`` (m), ``amplitude``, ``widths`` along x, y and z (m),
    ``peak_sidelobe``, ``mean_sidelobe_db``, ``ghosts``; in a notebook, a picture of them."""

    def __init__(self, content: list[dict[str, Any]], png: bytes) -> None:
        super().__init__(content)
        self._png = png

    def picture(self) -> bytes:
        """Planes through each point, dB below the peak, as a PNG."""
        return self._png

    def _repr_html_(self) -> str:
        from ._volumes import picture

        return picture(self._png, f"{len(self)} points")


def psf(
    run: RunFile | PathLike,
    points: Any = (),
    *,
    set: Settings = None,
    progress: Progress = None,
) -> PointSpreads:
    """Measures what the image of a point looks like, on simulated reflectors, and what the plan predicts for it.

    Parameters
    ----------
    run : RunFile or path
        Only the size of its scene is used, for the grid.
    points : array_like, shape (n, 3), optional
        m; by default in front of the middle of the grid, at its nearest, middle and farthest depth.
    set : mapping or list of str, optional
    progress : bool, tqdm or callable, optional

    Returns
    -------
    PointSpreads
    """
    import numpy as np

    places = np.asarray(points, dtype=np.float64)
    places = places.reshape(-1, 3) if places.ndim < 2 else places
    with reporting(progress) as callback:
        text, png = _holosonar.psf(run_of(run, typed(set)), places.tolist(), callback)
    return PointSpreads(json.loads(text)["points"], png)
