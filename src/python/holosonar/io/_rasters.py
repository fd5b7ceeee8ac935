"""Microphones in any order that fill a raster become rows and columns, for which reconstruction is fastest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def rastered(
    positions: NDArray[np.float64], samples: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Rows and columns, if the microphones fill an evenly spaced raster of constant z.

    Parameters
    ----------
    positions : ndarray, shape (n_mic, 3)
        m, in any order.
    samples : ndarray, shape (n_f, n_mic)

    Returns
    -------
    positions, samples : ndarray, shape (n_y, n_x, 3) and (n_f, n_y, n_x)
        What was given, where it is no raster. A raster needs two rows and two columns, and places that are right within a
        hundred-thousandth of the array's width: files often hold them in single precision.
    """
    import numpy as np

    extent = float(np.ptp(positions, axis=0).max()) if len(positions) else 0.0
    slack = 1e-5 * extent
    if extent == 0.0 or np.ptp(positions[:, 2]) > slack:
        return positions, samples
    indices = []
    for values in positions[:, :2].T:
        places, index = _steps(values, slack)
        if len(places) < 2 or np.ptp(np.diff(places)) > 2 * slack:
            return positions, samples
        indices.append((index, len(places)))
    (column, n_x), (row, n_y) = indices
    order = np.argsort(row * n_x + column, kind="stable")
    if not np.array_equal((row * n_x + column)[order], np.arange(n_x * n_y)):
        return positions, samples
    return positions[order].reshape(n_y, n_x, 3), samples[:, order].reshape(len(samples), n_y, n_x)


def _steps(values: NDArray[np.float64], slack: float) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """The different values, ascending, and for each value which it is; those within the slack are one."""
    import numpy as np

    order = np.argsort(values, kind="stable")
    begins = np.concatenate([[True], np.diff(values[order]) > slack])
    index = np.empty(len(values), np.intp)
    index[order] = np.cumsum(begins) - 1
    return values[order][begins], index
