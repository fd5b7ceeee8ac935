"""Images and sweeps by the workers of a Dask cluster: on one machine, on hosts over SSH, on Slurm or on Kubernetes.

>>> from dask.distributed import Client
>>> import holosonar.distributed
>>> with Client("scheduler:8786") as client:  # doctest: +SKIP
...     report = holosonar.distributed.image("/shared/run.toml", "/shared/out", client)

Each task is the command ``holosonar work``, or ``plan --part`` of a sweep, with all threads of its worker; nothing but numbers passes through the scheduler.
The run file, what it names, and the output folder must be at the same paths on all workers, which must see the same secret
of the user: a common home, or the variable ``XDG_STATE_HOME`` set to a common folder. See the guide's chapter on
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from ._errors import HolosonarError, InputError, Interrupted, SystemFailure

__all__ = ["image", "plan_sweep"]

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
    with _TURN:
        if event.is_set():
            return {"cancelled": "the job was cancelled"}
        command = [*_program(), *arguments, "--json", "--quiet", "-j", str(threads)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            while True:
                try:
                    out, err = process.communicate(timeout=_POLL)
                    break
                except subprocess.TimeoutExpired:
                    if event.is_set():
                        process.terminate()
    if process.returncode == 0:
        found: dict[str, Any] = json.loads(out)
        return found
    problem = err.strip().removeprefix("error: ") or f"{command[0]} ended with status {process.returncode}"
    if process.returncode == 2:
        # Not raised here, where it would be tried again, nor an interruption, which would end the worker.
        return {"refused": problem}
    if process.returncode in (130, 143):
        return {"cancelled": problem}
    raise (SystemFailure if process.returncode == 1 else HolosonarError)(problem)


def _checked(found: dict[str, Any]) -> dict[str, Any]:
    # What a command prints may count what is refused.
    if isinstance(found.get("refused"), str):
        raise InputError(found["refused"])
    if "cancelled" in found:
        raise Interrupted(found["cancelled"])
    return found


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
        yield submit, pending
    except BaseException:
        # The commands end by themselves, and store what is finished.
        dask.Event(cancelled, client=client).set()
        with suppress(TimeoutError):
            dask.wait(pending, timeout=10)
        client.cancel(pending)
        raise


def _workers(client: Any) -> int:
    return max(1, len(client.scheduler_info(n_workers=-1)["workers"]))


def _settings(settings: Sequence[str]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


def image(
    run: str | os.PathLike[str],
    output: str | os.PathLike[str],
    client: Any,
    *,
    config: str | os.PathLike[str] | None = None,
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
    dask = _dask()
    paths = [os.path.abspath(run), "-o", os.path.abspath(output)]
    job = paths + (["-c", os.path.abspath(config)] if config is not None else [])
    job += _settings(settings)
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
        return _checked(submit(["image", *job]).result())


#: Parts of a sweep for each worker, so that none waits long for the last.
_PARTS_EACH = 4


def plan_sweep(
    run: str | os.PathLike[str],
    keys: Mapping[str, str | Sequence[str]],
    output: str | os.PathLike[str],
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
        return _checked(submit(job).result())
