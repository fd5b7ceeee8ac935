"""Exceptions, one class for each kind of error, and the classes of warnings.

Every message says where something is wrong, what was expected and how to fix it.
"""

from __future__ import annotations


class HolosonarError(Exception):
    """What went wrong; the base class of this package's exceptions.

    Attributes
    ----------
    place : str or None
        The file, key, array or option at fault.
    """

    place: str | None = None


class InputError(HolosonarError, ValueError):
    """An argument, a key of a run file or an input file is wrong."""


class NotFoundError(HolosonarError, FileNotFoundError):
    """An input file is missing."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class SystemFailure(HolosonarError, OSError):
    """The operating system refused: a disk, a permission to write, a thread."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class OutOfMemoryError(HolosonarError, MemoryError):
    """Something does not fit in memory; the message says what would."""


class MemoryLimitError(InputError, OutOfMemoryError):
    """A job would take more memory than may be used, and was refused before it began."""


class LimitMissedError(HolosonarError):
    """A result missed a requested limit."""


class Interrupted(KeyboardInterrupt):
    """A job was stopped; no file was left incomplete."""

    place: str | None = None


class HolosonarWarning(UserWarning):
    """Something that the user should know although the work continues, such as grating lobes within the grid."""


class PrecisionWarning(HolosonarWarning):
    """Numbers were converted to single precision, in which samples are held."""
