"""Progress: from the reports of a job to a callback, or to bars of tqdm."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any, Union

from ._errors import HolosonarWarning, PrecisionWarning

#: Called with the name of a stage, the units of work done, and all of them. The total is 0 where it is not known; a stage
#: has ended when both are equal and positive.
ProgressCallback = Callable[[str, int, int], object]

#: What the ``progress`` argument of a job may be: ``True`` for bars of tqdm, the class ``tqdm.tqdm`` or one like it, or a
#: :data:`ProgressCallback`. An exception that a callback raises stops the job and is passed on.
Progress = Union[bool, type[Any], ProgressCallback, None]

_LOGGER = logging.getLogger("holosonar")


def note(message: str) -> None:
    """Logs what a stage found, at the level INFO of the logger ``holosonar``."""
    _LOGGER.info(message)


def warn(message: str) -> None:
    """Warns of something in a job; the job's function was called by a function of this package."""
    warnings.warn(message, HolosonarWarning, stacklevel=3)


def warn_of_precision(message: str, stacklevel: int) -> None:
    """Says that numbers were converted."""
    warnings.warn(message, PrecisionWarning, stacklevel=stacklevel + 1)


class _Bars:
    """Bars of tqdm, one for each running stage."""

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make
        self._bars: list[tuple[str, Any]] = []

    def __call__(self, stage: str, done: int, total: int) -> None:
        if not self._bars or self._bars[-1][0] != stage or done == 0:
            if done:
                return
            if not (self._bars and self._bars[-1][0] == stage):
                # A known total, or a bar that only shows the time.
                self._bars.append((stage, self._make(total=total or None, desc=stage, leave=False)))
                return
        bar = self._bars[-1][1]
        bar.update(min(done, bar.total or done) - bar.n)
        if 0 < total == done:
            bar.close()
            self._bars.pop()

    def close(self) -> None:
        while self._bars:
            self._bars.pop()[1].close()


class reporting:
    """The callback of a job, in a ``with`` statement that removes the bars at its end."""

    def __init__(self, progress: Progress) -> None:
        self._bars: _Bars | None = None
        self._callback: ProgressCallback | None = None
        if isinstance(progress, bool):
            progress = import_module("tqdm.auto").tqdm if progress else None
        if isinstance(progress, type):
            self._bars = _Bars(progress)
            self._callback = self._bars
        else:
            self._callback = progress

    def __enter__(self) -> ProgressCallback | None:
        return self._callback

    def __exit__(self, *exception: object) -> None:
        if self._bars is not None:
            self._bars.close()
