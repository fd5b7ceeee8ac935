"""Images, cubes, volumes, sweeps and checks by the workers of a Dask cluster: on one machine, on hosts over SSH, on Slurm or
on Kubernetes.

>>> from dask.distributed import Client
>>> import holosonar.distributed
>>> with Client("scheduler:8786") as client:  # doctest: +SKIP
...     report = holosonar.distributed.image("/shared/run.toml", "/shared/out", client)

Each task is the command ``holosonar work``, ``plan --part`` of a sweep or ``check`` of one seed, with all threads of its worker;
nothing but numbers passes through the scheduler. The run file, what it names, and the output must be at the same paths on all
workers, which must see the same secret of the user: a common home, or the variable ``XDG_STATE_HOME`` set to a common folder.
See the guide's chapter on interruption.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Union

from ._errors import HolosonarError, InputError, Interrupted, SystemFailure
from ._run_file import RunFile

__all__ = ["check", "image", "plan_sweep", "reconstruct", "simulate"]

_PathLike = Union[str, "os.PathLike[str]"]

#: One command at a time on each worker, for it takes all threads.
_TURN = threading.Lock()

#: Seconds between two looks at whether the job was cancelled.
_POLL = 0.2

#: Each round does the simulation, the depths, or what was lost; more than a few means that nothing is stored.
_ROUNDS = 6

Told = Callable[[int, int], None]


def _dask() -> Any:
    # Of which only a part is typed.
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise ImportError("distributed is missing; pip install 'holosonar[all]', or distributed") from error


def _program() -> list[str]:
    binary = os.environ.get("HOLOSONAR_BINARY")
    return [binary] if binary else [sys.executable, "-m", "holosonar"]


def _run(arguments: Sequence[str], cancelled: str) -> dict[str, Any]:
    """Runs a command on the worker that this is called on; ends it when the event of this name is set."""
    dask = _dask()
    threads = dask.get_worker().state.nthreads
    event = dask.Event(cancelled)

    def is_cancelled() -> bool:
        try:
            return bool(event.is_set())
        except OSError:
            # The scheduler cannot be reached: what is finished is stored all the same, for whoever does this task again.
            return False

    with _TURN:
        if is_cancelled():
            return {"cancelled": "the job was cancelled"}
        command = [*_program(), *arguments, "--json", "--quiet", "-j", str(threads)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            while True:
                try:
                    out, err = process.communicate(timeout=_POLL)
                    break
                except subprocess.TimeoutExpired:
                    if is_cancelled():
                        process.terminate()
    # A check prints what missed a limit (3), or what was refused (2), too.
    if process.returncode == 0 or (process.returncode in (2, 3) and out):
        return {"printed": json.loads(out)}
    problem = err.strip().removeprefix("error: ") or f"{command[0]} ended with status {process.returncode}"
    if process.returncode == 2:
        # Not raised here, where it would be tried again, nor an interruption, which would end the worker.
        return {"refused": problem}
    if process.returncode in (130, 143):
        return {"cancelled": problem}
    raise (SystemFailure if process.returncode == 1 else HolosonarError)(problem)


def _checked(found: dict[str, Any]) -> Any:
    """What a command printed."""
    if "refused" in found:
        raise InputError(found["refused"])
    if "cancelled" in found:
        raise Interrupted(found["cancelled"])
    return found["printed"]


@contextmanager
def _tasks(client: Any, retries: int) -> Iterator[tuple[Callable[[Sequence[str]], Any], list[Any]]]:
    """Submits commands to workers, and lists those that may be running; ends these if the block fails."""
    dask = _dask()
    cancelled = f"holosonar-{uuid.uuid4()}"
    pending: list[Any] = []

    def submit(arguments: Sequence[str]) -> Any:
        task = client.submit(_run, arguments, cancelled, pure=False, retries=retries)
        pending.append(task)
        return task

    try:
        # It need not be the default one.
        with client.as_current():
            yield submit, pending
    except BaseException:
        # The commands end by themselves, and store what is finished.
        dask.Event(cancelled, client=client).set()
        with client.as_current(), suppress(TimeoutError):
            dask.wait(pending, timeout=10)
        client.cancel(pending)
        raise


def _workers(client: Any) -> int:
    return max(1, len(client.scheduler_info(n_workers=-1)["workers"]))


def _settings(settings: Sequence[str]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


def _config(config: _PathLike | None) -> list[str]:
    return ["-c", os.path.abspath(config)] if config is not None else []


def _shared(
    command: Sequence[str],
    job: Sequence[str],
    output: _PathLike,
    client: Any,
    share: tuple[int | None, int],
    progress: Told | None,
) -> Any:
    """Has the units of a job computed, and then the command done that takes them up; returns what that prints."""
    dask = _dask()
    (parts, retries) = share
    count = parts if parts is not None else _workers(client)
    if count < 1:
        raise InputError(f"parts is {count}, and 1 or more were expected")
    with _tasks(client, retries) as (submit, pending):
        left = None
        for _ in range(_ROUNDS):
            tasks = [submit(["work", *job, "--part", f"{part}/{count}"]) for part in range(1, count + 1)]
            left_now = []
            for task in dask.as_completed(tasks):
                done = _checked(task.result())
                left_now.append(done["left"])
                if progress is not None:
                    progress(done["units"] - min(left_now), done["units"])
            pending.clear()
            if min(left_now) == 0:
                break
            if left == min(left_now):
                raise SystemFailure(
                    f"{left} units are still missing after all were computed: the workers do not share {output}, or not the "
                    "user's secret (set XDG_STATE_HOME to a folder that all can reach)"
                )
            left = min(left_now)
        return _checked(submit(command).result())


def image(
    run: _PathLike,
    output: _PathLike,
    client: Any,
    *,
    config: _PathLike | None = None,
    settings: Sequence[str] = (),
    parts: int | None = None,
    retries: int = 3,
    progress: Told | None = None,
) -> dict[str, Any]:
    """Images a scene or a cube by the workers of a cluster, with the bytes of one process.

    Workers may come and go: their tasks are done by others, and what they had stored is used.

    Parameters
    ----------
    run : path
        Run file, mesh, list of reflectors or cube, on a file system that all workers share.
    output : path
        Folder of the results, on such a file system.
    client : distributed.Client
        A client of the cluster.
    config : path, optional
        Run file for a cube.
    settings : sequence of str
        What is changed in the run file, as ``"sweep.step=20"``.
    parts : int, optional
        Tasks of each stage; by default one for each worker.
    retries : int
        How often a task that fails for want of memory or disk is tried again.
    progress : callable, optional
        Called with the number of units that are stored and of all that there are.

    Returns
    -------
    dict
        The report, as in ``report.json``.

    Raises
    ------
    InputError
        The job is refused.
    SystemFailure
        Files cannot be written, or the workers do not see one another's units.
    KeyboardInterrupt
        Ctrl-C: the tasks on the workers are ended first. What was stored is used by the next call.
    """
    job = [os.path.abspath(run), "-o", os.path.abspath(output), *_config(config), *_settings(settings)]
    report: dict[str, Any] = _shared(["image", *job], job, output, client, (parts, retries), progress)
    return report


def simulate(
    run: _PathLike,
    output: _PathLike,
    client: Any,
    *,
    settings: Sequence[str] = (),
    parts: int | None = None,
    retries: int = 3,
    progress: Told | None = None,
) -> Path:
    """Simulates the cube of a scene by the workers of a cluster, with the bytes of one process.

    Workers may come and go: their tasks are done by others, and what they had stored is used. Each holds the microphones that
    it simulates; the one that writes the file holds the cube.

    Parameters
    ----------
    run : path
        Run file, mesh or list of reflectors, on a file system that all workers share.
    output : path
        The cube, ``.npz`` or ``.zarr``, complex64 ``(n_f, n_y, n_x)`` as :func:`holosonar.simulate` returns it, or its recording,
        ``.wav``; on such a file system.
    client : distributed.Client
        A client of the cluster.
    settings : sequence of str
        What is changed in the run file, as ``"sweep.step=20"``.
    parts : int, optional
        Tasks; by default one for each worker.
    retries : int
        How often a task that fails for want of memory or disk is tried again.
    progress : callable, optional
        Called with the number of units that are stored and of all that there are.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        The job is refused.
    SystemFailure
        The file cannot be written, or the workers do not see one another's units.
    KeyboardInterrupt
        Ctrl-C: the tasks on the workers are ended first. What was stored is used by the next call.
    """
    written = Path(os.path.abspath(output))
    job = [os.path.abspath(run), "-o", str(written), *_settings(settings)]
    _shared(["simulate", *job], job, output, client, (parts, retries), progress)
    return written


def reconstruct(
    cube: _PathLike,
    output: _PathLike | Sequence[_PathLike],
    client: Any,
    *,
    config: _PathLike | None = None,
    settings: Sequence[str] = (),
    parts: int | None = None,
    retries: int = 3,
    progress: Told | None = None,
) -> list[Path]:
    """Reconstructs a volume from a cube by the workers of a cluster, with the bytes of one process.

    Workers may come and go: their tasks are done by others, and what they had stored is used. None holds the volume, except for
    the one that writes an ``.exr`` or ``.vdb``.

    Parameters
    ----------
    cube : path
        The cube, ``.npz`` or ``.zarr``, on a file system that all workers share.
    output : path or sequence of paths
        The volume, ``.npz``, ``.zarr``, ``.exr``, ``.vti``, ``.nrrd`` or ``.vdb``, ``(n_z, n_y, n_x)``; several to write it in
        several formats; on such a file system. Units are stored beside the first.
    client : distributed.Client
        A client of the cluster.
    config : path, optional
        Run file, of which ``[calibration]``, ``[grid]``, ``[reconstruct]`` and ``[output]`` are used.
    settings : sequence of str
        What is changed in it, as ``"grid.z=[1,2]"`` (m).
    parts : int, optional
        Tasks; by default one for each worker.
    retries : int
        How often a task that fails for want of memory or disk is tried again.
    progress : callable, optional
        Called with the number of units that are stored and of all that there are.

    Returns
    -------
    list of Path
        The files; a very deep ``.exr`` volume takes several.

    Raises
    ------
    InputError
        The job is refused, as one with a ``[refine]`` is, which takes the whole volume.
    SystemFailure
        Files cannot be written, or the workers do not see one another's units.
    KeyboardInterrupt
        Ctrl-C: the tasks on the workers are ended first. What was stored is used by the next call.
    """
    outputs = [output] if isinstance(output, (str, os.PathLike)) else list(output)
    if not outputs:
        raise InputError("output is empty, and one path or more were expected")
    job = [os.path.abspath(cube), *_config(config), *_settings(settings)]
    names = [word for path in outputs for word in ("-o", os.path.abspath(path))]
    written = _shared(
        ["reconstruct", *job, *names], [*job, *names[:2]], outputs[0], client, (parts, retries), progress
    )
    return [Path(file) for file in written["files"]]


#: Parts of a sweep for each worker, so that none waits long for the last.
_PARTS_EACH = 4


def plan_sweep(
    run: _PathLike,
    keys: Mapping[str, str | Sequence[str]],
    output: _PathLike,
    client: Any,
    *,
    seeds: Sequence[int] = (),
    measure: str = "chamfer_distance",
    settings: Sequence[str] = (),
    parts: int | None = None,
    retries: int = 3,
    progress: Told | None = None,
) -> dict[str, Any]:
    """Simulates a sweep by the workers of a cluster, with the bytes of one process.

    Workers may come and go, and what they had finished is used, also by the next call.

    Parameters
    ----------
    run : path
        Run file or mesh, on a file system that all workers share.
    keys : mapping
        Values by key, as ``{"array.extent": "0.5:2:0.25", "array.layout": ["grid", "spiral"]}``: a text as after
        ``--sweep KEY=``, or a list of values.
    output : path
        Folder of the results, on such a file system: ``sweep.csv``, ``sweep.json`` and pictures.
    client : distributed.Client
        A client of the cluster.
    seeds : sequence of int, optional
        Seeds of ``[reflectors]``; by default those of ``[expect]``, or the run file's own.
    measure : str
        The metric whose error is weighed against the time of the measurement and microphones.
    settings : sequence of str
        What is changed in the run file, as ``"sweep.step=20"``.
    parts : int, optional
        Tasks; by default four for each worker.
    retries : int
        How often a task that fails for want of memory or disk is tried again.
    progress : callable, optional
        Called with the number of combinations of finished tasks and of all that there are.

    Returns
    -------
    dict
        The sweep, as in ``sweep.json``.

    Raises
    ------
    InputError
        The sweep is refused.
    SystemFailure
        Files cannot be written.
    KeyboardInterrupt
        Ctrl-C: the tasks on the workers are ended first. What is finished is used by the next call.
    """
    dask = _dask()
    count = parts if parts is not None else _PARTS_EACH * _workers(client)
    if count < 1:
        raise InputError(f"parts is {count}, and 1 or more were expected")
    job = ["plan", os.path.abspath(run), "-o", os.path.abspath(output), "--simulate", "--measure", measure]
    job += _settings(settings)
    for key, values in keys.items():
        job += ["--sweep", f"{key}={values if isinstance(values, str) else ','.join(map(str, values))}"]
    if seeds:
        job += ["--seeds", ",".join(map(str, seeds))]
    with _tasks(client, retries) as (submit, _):
        done = 0
        for task in dask.as_completed([submit([*job, "--part", f"{part}/{count}"]) for part in range(1, count + 1)]):
            found = _checked(task.result())
            done += found["part"]
            if progress is not None:
                progress(done, found["combinations"])
        sweep: dict[str, Any] = _checked(submit(job).result())
        return sweep


def check(
    runs: _PathLike | Sequence[_PathLike],
    client: Any,
    *,
    seeds: Sequence[int] = (),
    oracle: bool = False,
    settings: Sequence[str] = (),
    retries: int = 3,
    progress: Told | None = None,
) -> list[dict[str, Any]]:
    """Images scenes by the workers of a cluster and checks each against its ``[expect]``: a task for each scene and seed.

    Nothing is written. Each image takes the memory that it takes alone.

    Parameters
    ----------
    runs : path or sequence of paths
        Run files, on a file system that all workers share.
    client : distributed.Client
        A client of the cluster.
    seeds : sequence of int, optional
        Seeds of ``[reflectors]``, whose mean must keep the limits; by default those of ``[expect]``, or the run file's own.
    oracle : bool
        Also what the aperture could do at best.
    settings : sequence of str
        What is changed in the run files, as ``"sweep.step=20"``.
    retries : int
        How often a task that fails for want of memory or disk is tried again.
    progress : callable, optional
        Called with the number of images that are scored and of all that there are.

    Returns
    -------
    list of dict
        A row for each scene, as ``holosonar check --json`` prints them for the same absolute paths: ``scene``, ``seeds``,
        ``limits`` (``kept`` says whether a limit is), ``scores`` by seed, and ``oracle``; or ``scene`` and ``error`` of one that
        failed, beside which the others are still run. Depths and errors are in m.

    Raises
    ------
    InputError
        There is no run file.
    KeyboardInterrupt
        Ctrl-C: the tasks on the workers are ended first.
    """
    dask = _dask()
    listed = [runs] if isinstance(runs, (str, os.PathLike)) else list(runs)
    if not listed:
        raise InputError("runs is empty, and one run file or more were expected")
    paths = [os.path.abspath(run) for run in listed]
    with _tasks(client, retries) as (submit, _):
        tasks: list[list[Any]] = []
        for path in paths:
            job = ["check", path, *_settings(settings)]
            each = [["--seeds", str(seed)] for seed in seeds or _seeds_of(path, settings)]
            # The oracle has no seed, and is found with the first.
            first = ["--oracle"] if oracle else []
            tasks.append([submit([*job, *seed, *(first if i == 0 else [])]) for i, seed in enumerate(each or [[]])])
        everything = [task for of_run in tasks for task in of_run]
        for done, _task in enumerate(dask.as_completed(everything), start=1):
            if progress is not None:
                progress(done, len(everything))
        return [_row(path, of_run) for path, of_run in zip(paths, tasks)]


def _seeds_of(path: str, settings: Sequence[str]) -> list[int]:
    """The seeds with which a scene is checked; none of a run file that the command is going to refuse."""
    try:
        run = RunFile(path, set=settings)
    except (HolosonarError, OSError):
        return []
    return run.to_dict().get("expect", {}).get("seeds") or [run["reflectors.seed"]]


def _row(path: str, tasks: Sequence[Any]) -> dict[str, Any]:
    """The row of a scene, from those of its seeds."""
    rows: list[dict[str, Any]] = []
    for task in tasks:
        try:
            rows += _checked(task.result())
        except SystemFailure as error:
            rows.append({"scene": path, "error": str(error)})
    failed = [row for row in rows if "error" in row]
    if failed:
        return failed[0]
    row = dict(rows[0])
    row["seeds"] = [seed for one in rows for seed in one["seeds"]]
    row["scores"] = [scores for one in rows for scores in one["scores"]]
    row["limits"] = [_limit([one["limits"][i] for one in rows]) for i in range(len(row["limits"]))]
    return row


def _limit(limits: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """A limit on the mean over the seeds, from those of single seeds; where one has no value, there is no mean."""
    each = [value for limit in limits for value in limit["each"]]
    value = None
    if None not in each:
        # In their order and without compensation, as the command does.
        total = 0.0
        for one in each:
            total += one
        value = total / len(each)
    (least, most) = (limits[0]["min"], limits[0]["max"])
    kept = value is not None and (least is None or value >= least) and (most is None or value <= most)
    return {**limits[0], "value": value, "each": each, "kept": kept}
