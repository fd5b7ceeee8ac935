"""Images, cubes, volumes, sweeps and checks by the workers of a Dask cluster: on one machine, on hosts over SSH, on Slurm or
on Kubernetes.

>>> from dask.distributed import Client
>>> import holosonar.distributed
>>> with Client("scheduler:8786") as client:  # doctest: +SKIP
...     report = holosonar.distributed.image("/shared/run.toml", "/shared/out", client)

Each task is the command ``holosonar work``, ``plan --part`` of a sweep or ``check`` of one seed, with all threads of its worker;
nothing but numbers passes through the scheduler. The run file, what it names, and the output must be at the same paths on all
workers, which must see the same secret of the user: a common home, or the variable ``XDG_STATE_HOME`` set to a common folder.
Where workers share no folder, paths are URLs of an object store that fsspec reaches, ``"s3://bucket/job/run.toml"``: workers
copy a run file with all that is in its folder, and units, and are told the user's secret. See the guide's chapter on
interruption.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Union

from . import _holosonar
from ._errors import HolosonarError, InputError, Interrupted, SystemFailure
from ._remote import Store, Units, copies_of, first_depth, forget, is_url, local_or_url
from ._run_file import RunFile

__all__ = ["check", "image", "plan_sweep", "reconstruct", "simulate"]

_PathLike = Union[str, "os.PathLike[str]"]

#: One command at a time on each worker, for it takes all threads.
_TURN = threading.Lock()

#: Seconds between two looks at whether the job was cancelled.
_POLL = 0.2

#: Each round does the simulation, the depths, shards that several tasks have the depths of, or what was lost; more than a few
#: mean that nothing is stored.
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


def _run(
    arguments: Sequence[str], cancelled: str, store: Store | None = None, needed: Units | None = None
) -> dict[str, Any]:
    """Runs a command on the worker that this is called on; ends it when the event of this name is set.

    With a ``store`` it works on copies of what it reads, and of the units that are ``needed``.
    """
    dask = _dask()
    worker = dask.get_worker()
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
        command = [*_program(), *arguments, "--json", "--quiet", "-j", str(worker.state.nthreads)]
        if store is None:
            return _outcome(*_executed(command, None, is_cancelled))
        try:
            copies = copies_of(store, worker.local_directory)
            command = copies.localised(command)
            copies.fetch(needed)
        except InputError as error:
            return {"refused": str(error)}
        (status, out, err) = _executed(command, copies.environment, is_cancelled)
        # Whatever it ended with, what is finished is of use.
        copies.store()
        return _outcome(status, copies.restored(out), copies.restored(err))


def _executed(
    command: Sequence[str], environment: Mapping[str, str] | None, is_cancelled: Callable[[], bool]
) -> tuple[int, str, str]:
    """The exit status of a command, and what it printed; it is ended once it is cancelled."""
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        while True:
            try:
                (out, err) = process.communicate(timeout=_POLL)
                return process.returncode, out, err
            except subprocess.TimeoutExpired:
                if is_cancelled():
                    process.terminate()


def _outcome(status: int, out: str, err: str) -> dict[str, Any]:
    """What a command's end means."""
    # A check prints what missed a limit (3), or what was refused (2), too.
    if status == 0 or (status in (2, 3) and out):
        return {"printed": json.loads(out)}
    problem = err.strip().removeprefix("error: ") or f"a command ended with status {status}"
    if status == 2:
        # Not raised here, where it would be tried again, nor an interruption, which would end the worker.
        return {"refused": problem}
    if status in (130, 143):
        return {"cancelled": problem}
    raise (SystemFailure if status == 1 else HolosonarError)(problem)


def _checked(found: dict[str, Any]) -> Any:
    """What a command printed."""
    if "refused" in found:
        raise InputError(found["refused"])
    if "cancelled" in found:
        raise Interrupted(found["cancelled"])
    return found["printed"]


def _store(paths: Iterable[str], options: Mapping[str, Any] | None) -> Store | None:
    """The store of a job, if one of its paths is in one."""
    if not any(map(is_url, paths)):
        return None
    return Store(f"holosonar-{uuid.uuid4()}", _holosonar.users_secret(), dict(options or {}))


@contextmanager
def _tasks(client: Any, retries: int, store: Store | None) -> Iterator[tuple[Callable[..., Any], list[Any]]]:
    """Submits commands to workers, and lists those that may be running; ends these if the block fails."""
    dask = _dask()
    cancelled = store.job if store else f"holosonar-{uuid.uuid4()}"
    pending: list[Any] = []

    def submit(arguments: Sequence[str], needed: Units | None = None) -> Any:
        task = client.submit(_run, arguments, cancelled, store, needed, pure=False, retries=retries)
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
    finally:
        if store:
            forget(store.job)
            client.run(forget, store.job, on_error="ignore")


def _parts(parts: int | None, client: Any, each: int = 1) -> int:
    """The number of tasks: as asked for, or ``each`` for every worker."""
    if parts is None:
        return each * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    if parts < 1:
        raise InputError(f"parts is {parts}, and 1 or more were expected")
    return parts


def _runs(units: Sequence[int], count: int) -> list[Sequence[int]]:
    """Units in order, divided among at most so many tasks."""
    ends = [len(units) * k // count for k in range(count + 1)]
    return [units[begin:end] for (begin, end) in zip(ends, ends[1:]) if begin < end]


def _settings(settings: Sequence[str]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


def _config(config: _PathLike | None) -> list[str]:
    return ["-c", local_or_url(config)] if config is not None else []


def _shared(
    command: Sequence[str],
    job: Sequence[str],
    output: _PathLike,
    client: Any,
    share: tuple[int | None, int, Mapping[str, Any] | None],
    progress: Told | None,
) -> Any:
    """Has the units of a job computed, and then the command done that takes them up; returns what that prints."""
    dask = _dask()
    (parts, retries, options) = share
    count = _parts(parts, client)
    with _tasks(client, retries, _store(command, options)) as (submit, pending):
        missing: set[int] | None = None
        done: Any = None
        compressed = False
        shards: dict[int, Any] = {}

        def take(task: Any) -> None:
            nonlocal missing, done, compressed
            done = _checked(task.result())
            # A worker that shares no folder knows only of the units that it computed or needed.
            missing = set(done["missing"]) if missing is None else missing.intersection(done["missing"])
            compressed = compressed or done["compressed"]
            done["compressed"] = compressed
            shards.update((left["unit"], left) for left in done["shards_left"])
            if progress is not None:
                progress(done["units"] - len(missing), done["units"])

        # With the first unit one worker places the reflectors of a scene, or compresses the sweep of a cube, for all.
        take(submit(["work", *job, "--units", "0"], Units(left=True)))
        for _ in range(_ROUNDS):
            tasks = []
            before = missing
            if missing and min(missing) == done["simulation"] < first_depth(done):
                # Likewise that of a scene, once all of it is simulated.
                sweep = min(missing)
                take(submit(["work", *job, "--units", str(sweep)], Units((range(sweep),))))
            if missing and shards.keys() >= missing:
                for run in _runs(sorted(missing), count):
                    needed = Units.of_shards([shards[unit] for unit in run])
                    tasks.append(submit(["work", *job, "--units", f"{run[0]}-{run[-1]}"], needed))
            else:
                for part in range(1, count + 1):
                    needed = Units.of_part(part, count, done)
                    tasks.append(submit(["work", *job, "--part", f"{part}/{count}"], needed))
            for task in dask.as_completed(tasks):
                take(task)
            pending.clear()
            if not missing:
                break
            if missing == before:
                raise SystemFailure(
                    f"{len(missing)} units are still missing after all were computed: the workers do not share {output}, or not "
                    "the user's secret (set XDG_STATE_HOME to a folder that all can reach)"
                )
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
    storage_options: Mapping[str, Any] | None = None,
    progress: Told | None = None,
) -> dict[str, Any]:
    """Images a scene or a cube by the workers of a cluster, with the bytes of one process.

    Workers may come and go: their tasks are done by others, and what they had stored is used.

    Parameters
    ----------
    run : path
        Run file, mesh, list of reflectors or cube, on a file system that all workers share, or a URL.
    output : path
        Folder of the results, on such a file system, or a URL.
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
    storage_options : mapping, optional
        Keywords of fsspec for paths that are URLs, such as credentials; workers are told them by the scheduler.
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
    job = [local_or_url(run), "-o", local_or_url(output), *_config(config), *_settings(settings)]
    report: dict[str, Any] = _shared(["image", *job], job, output, client, (parts, retries, storage_options), progress)
    return report


def simulate(
    run: _PathLike,
    output: _PathLike,
    client: Any,
    *,
    settings: Sequence[str] = (),
    parts: int | None = None,
    retries: int = 3,
    storage_options: Mapping[str, Any] | None = None,
    progress: Told | None = None,
) -> Path | str:
    """Simulates the cube of a scene by the workers of a cluster, with the bytes of one process.

    Workers may come and go: their tasks are done by others, and what they had stored is used. Each holds the microphones that
    it simulates; the one that writes the file holds the cube.

    Parameters
    ----------
    run : path
        Run file, mesh or list of reflectors, on a file system that all workers share, or a URL.
    output : path
        The cube, ``.npz`` or ``.zarr``, complex64 ``(n_f, n_y, n_x)`` as :func:`holosonar.simulate` returns it, or its recording,
        ``.wav``; on such a file system, or a URL.
    client : distributed.Client
        A client of the cluster.
    settings : sequence of str
        What is changed in the run file, as ``"sweep.step=20"``.
    parts : int, optional
        Tasks; by default one for each worker.
    retries : int
        How often a task that fails for want of memory or disk is tried again.
    storage_options : mapping, optional
        Keywords of fsspec for paths that are URLs, such as credentials; workers are told them by the scheduler.
    progress : callable, optional
        Called with the number of units that are stored and of all that there are.

    Returns
    -------
    Path or str
        The file, or its URL.

    Raises
    ------
    InputError
        The job is refused.
    SystemFailure
        The file cannot be written, or the workers do not see one another's units.
    KeyboardInterrupt
        Ctrl-C: the tasks on the workers are ended first. What was stored is used by the next call.
    """
    written = local_or_url(output)
    job = [local_or_url(run), "-o", written, *_settings(settings)]
    _shared(["simulate", *job], job, output, client, (parts, retries, storage_options), progress)
    return written if is_url(written) else Path(written)


def reconstruct(
    cube: _PathLike,
    output: _PathLike | Sequence[_PathLike],
    client: Any,
    *,
    config: _PathLike | None = None,
    settings: Sequence[str] = (),
    parts: int | None = None,
    retries: int = 3,
    storage_options: Mapping[str, Any] | None = None,
    progress: Told | None = None,
) -> list[Path | str]:
    """Reconstructs a volume from a cube by the workers of a cluster, with the bytes of one process.

    Workers may come and go: their tasks are done by others, and what they had stored is used. None holds the volume, except for
    the one that writes an ``.exr`` or ``.vdb``.

    Parameters
    ----------
    cube : path
        The cube, ``.npz`` or ``.zarr``, on a file system that all workers share, or a URL.
    output : path or sequence of paths
        The volume, ``.npz``, ``.zarr``, ``.exr``, ``.vti``, ``.nrrd`` or ``.vdb``, ``(n_z, n_y, n_x)``; several to write it in
        several formats; on such a file system, or URLs. Units are stored beside the first.
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
    storage_options : mapping, optional
        Keywords of fsspec for paths that are URLs, such as credentials; workers are told them by the scheduler.
    progress : callable, optional
        Called with the number of units that are stored and of all that there are.

    Returns
    -------
    list of Path or str
        The files, or their URLs; a very deep ``.exr`` volume takes several.

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
    job = [local_or_url(cube), *_config(config), *_settings(settings)]
    names = [word for path in outputs for word in ("-o", local_or_url(path))]
    written = _shared(
        ["reconstruct", *job, *names], [*job, *names[:2]], outputs[0], client, (parts, retries, storage_options), progress
    )
    return [file if is_url(file) else Path(file) for file in written["files"]]


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
    storage_options: Mapping[str, Any] | None = None,
    progress: Told | None = None,
) -> dict[str, Any]:
    """Simulates a sweep by the workers of a cluster, with the bytes of one process.

    Workers may come and go, and what they had finished is used, also by the next call.

    Parameters
    ----------
    run : path
        Run file or mesh, on a file system that all workers share, or a URL.
    keys : mapping
        Values by key, as ``{"array.extent": "0.5:2:0.25", "array.layout": ["grid", "spiral"]}``: a text as after
        ``--sweep KEY=``, or a list of values.
    output : path
        Folder of the results, on such a file system, or a URL: ``sweep.csv``, ``sweep.json`` and pictures.
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
    storage_options : mapping, optional
        Keywords of fsspec for paths that are URLs, such as credentials; workers are told them by the scheduler.
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
    count = _parts(parts, client, _PARTS_EACH)
    job = ["plan", local_or_url(run), "-o", local_or_url(output), "--simulate", "--measure", measure]
    job += _settings(settings)
    for key, values in keys.items():
        job += ["--sweep", f"{key}={values if isinstance(values, str) else ','.join(map(str, values))}"]
    if seeds:
        job += ["--seeds", ",".join(map(str, seeds))]
    with _tasks(client, retries, _store(job, storage_options)) as (submit, _):
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
    storage_options: Mapping[str, Any] | None = None,
    progress: Told | None = None,
) -> list[dict[str, Any]]:
    """Images scenes by the workers of a cluster and checks each against its ``[expect]``: a task for each scene and seed.

    Nothing is written. Each image takes the memory that it takes alone.

    Parameters
    ----------
    runs : path or sequence of paths
        Run files, on a file system that all workers share, or URLs.
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
    storage_options : mapping, optional
        Keywords of fsspec for paths that are URLs, such as credentials; workers are told them by the scheduler.
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
    paths = [local_or_url(run) for run in listed]
    store = _store(paths, storage_options)
    with _tasks(client, retries, store) as (submit, _):
        tasks: list[list[Any]] = []
        for path in paths:
            job = ["check", path, *_settings(settings)]
            each = [["--seeds", str(seed)] for seed in seeds or _seeds_of(path, settings, store)]
            # The oracle has no seed, and is found with the first.
            first = ["--oracle"] if oracle else []
            tasks.append([submit([*job, *seed, *(first if i == 0 else [])]) for i, seed in enumerate(each or [[]])])
        everything = [task for of_run in tasks for task in of_run]
        for done, _task in enumerate(dask.as_completed(everything), start=1):
            if progress is not None:
                progress(done, len(everything))
        return [_row(path, of_run) for path, of_run in zip(paths, tasks)]


def _seeds_of(path: str, settings: Sequence[str], store: Store | None) -> list[int]:
    """The seeds with which a scene is checked; none of a run file that the command is going to refuse."""
    try:
        file = copies_of(store).input(path) if store and is_url(path) else path
        run = RunFile(file, set=settings)
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
