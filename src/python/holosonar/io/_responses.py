"""Impulse responses to the tones of a sweep, by the Fourier sum as it is defined."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._cubes import Cube, Geometry, Instrument, float64
from .._errors import InputError
from ._rasters import rastered

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

#: Samples of time that are summed at once: phases of one block take 16 bytes for each of them and each tone.
BLOCK = 1024


def fourier_sum(
    signals: NDArray[Any], sample_rate: float, frequencies: NDArray[np.float64], start: float | NDArray[np.float64] = 0.0
) -> NDArray[np.complex128]:
    """S(f) = sum over n of s[n] exp(-i 2 pi f (start + n / sample_rate)), at any frequencies.

    Parameters
    ----------
    signals : ndarray, shape (n_mic, n_samples)
    sample_rate : float
        Hz.
    frequencies : ndarray, shape (n_f,)
        Hz.
    start : float or ndarray, shape (n_mic,)
        Time of the first sample, s.

    Returns
    -------
    ndarray, shape (n_f, n_mic)
        Costs n_f n_samples n_mic multiplications, as a matrix product.
    """
    import numpy as np

    total = np.zeros((len(frequencies), len(signals)), np.complex128)
    for first in range(0, signals.shape[1], BLOCK):
        block = np.asarray(signals[:, first : first + BLOCK])
        ticks = first + np.arange(block.shape[1])
        cycles = np.outer(frequencies / sample_rate, ticks)
        # Wrapped before the exponential, so that long recordings lose nothing.
        total += np.exp(-2j * np.pi * (cycles - np.round(cycles))) @ block.T
    late = np.outer(frequencies, np.broadcast_to(np.asarray(start, np.float64), (len(signals),)))
    total *= np.exp(-2j * np.pi * (late - np.round(late)))
    return total


def from_impulse_responses(
    responses: ArrayLike,
    sample_rate: float,
    mic_positions: ArrayLike,
    source: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    frequencies: ArrayLike,
    sound_speed: float = 343.0,
    geometry: Geometry = "fixed-source",
    start: ArrayLike = 0.0,
    window: ArrayLike | None = None,
    reference: ArrayLike | None = None,
    carrier: float = 0.0,
) -> Cube:
    """The cube of impulse responses: their Fourier sum at the tones of a sweep, conjugated so that phases grow along a path.

    The sum is m(f, r) = conj(sum over n of h[r, n] exp(-i 2 pi f (start + n / sample_rate))), at exactly these frequencies:
    they need not be those of an FFT. A response of a single 1 has the amplitude 1 at all of them.

    Parameters
    ----------
    responses : array_like, shape (n_mic, n_samples) or (n_y, n_x, n_samples)
        h, one for each microphone, of one loudspeaker. Complex ones are analytic signals, or in the base band of ``carrier``.
    sample_rate : float
        Hz.
    mic_positions : array_like, shape (n_mic, 3) or (n_y, n_x, 3)
        m. Those that fill a raster become rows and columns.
    source : (float, float, float)
        Position of the loudspeaker, m.
    frequencies : array_like, shape (n_f,)
        Tones, Hz, ascending; below half of the sample rate.
    sound_speed : float
        m/s.
    geometry : {"fixed-source", "monostatic"}
    start : float or array_like, shape (n_mic,)
        When the first sample was taken, s after the sound left the loudspeaker: negative for a latency of the electronics, or
        for samples before it.
    window : array_like, shape (n_samples,), optional
        Weights of the samples, as of ``scipy.signal.windows``: what is far away, or the direct wave, is taken out with it.
    reference : array_like, shape (n_samples_sent,), optional
        What was sent, at the same sample rate, from time 0 on. Then ``responses`` are recordings of it, and their spectra are
        divided by its spectrum.
    carrier : float
        Hz by which complex responses were shifted down, s(t) exp(-i 2 pi carrier t).

    Returns
    -------
    Cube
        In quadrature, of shape (n_f, n_mic) or (n_f, n_y, n_x).

    Raises
    ------
    InputError
        Shapes that disagree, values that are not finite, tones that the sample rate does not hold, or that were not sent.

    Examples
    --------
    >>> import numpy as np
    >>> responses = np.zeros((2, 480))
    >>> responses[:, 280] = 1.0                              # an echo after 280 samples, 2 m of path
    >>> cube = from_impulse_responses(responses, 48e3, [(0, 0, 0), (0.1, 0, 0)], frequencies=[10e3, 11e3])
    >>> np.allclose(cube.samples[:, 0], np.exp(2j * np.pi * np.array([10e3, 11e3]) * 280 / 48e3))
    True
    """
    import numpy as np

    tones, positions = np.atleast_1d(float64(frequencies, "frequencies")), float64(mic_positions, "mic_positions", 3)
    places = positions.reshape(-1, 3)
    signals = np.asarray(responses)
    if signals.dtype.kind not in "iufc":
        raise InputError(f"responses: numbers were expected, not an array of {signals.dtype}")
    if signals.ndim < 2 or signals.shape[:-1] not in ((len(places),), positions.shape[:-1]):
        raise InputError(
            f"responses: have the shape {list(signals.shape)}; [{len(places)}, n_samples] was expected, one for each "
            "microphone. Of several loudspeakers give one at a time, responses[i]"
        )
    signals = signals.reshape(len(places), -1)
    if not np.isfinite(signals).all():
        raise InputError(f"responses: that of microphone {int(np.argmin(np.isfinite(signals).all(axis=1)))} is not finite")
    check_tones(tones, sample_rate, signals.dtype.kind == "c", carrier)
    starts = np.asarray(start, np.float64)
    if starts.ndim and starts.shape != (len(places),):
        raise InputError(f"start: has the shape {list(starts.shape)}; one time, or {len(places)} of them were expected")
    if window is not None:
        weights = float64(window, "window")
        if weights.shape != (signals.shape[1],):
            raise InputError(
                f"window: has the shape {list(weights.shape)}; {signals.shape[1]} weights were expected, one for each sample"
            )
        signals = signals * weights
    spectrum = fourier_sum(signals, sample_rate, tones - carrier, starts)
    if reference is not None:
        spectrum /= _sent(reference, sample_rate, tones)[:, None]
    return cube_of(spectrum, tones, places, source, sound_speed, geometry)


def cube_of(
    spectrum: NDArray[Any],
    frequencies: NDArray[np.float64],
    positions: NDArray[np.float64],
    source: tuple[float, float, float],
    sound_speed: float,
    geometry: Geometry,
    phase_sign: int = -1,
) -> Cube:
    """The cube of samples [n_f, n_mic] whose phase falls along a path, unless ``phase_sign`` is 1; as a raster if it is one."""
    import numpy as np

    places, samples = rastered(positions, spectrum)
    instrument = Instrument(frequencies, places, sound_speed, geometry, source)
    return Cube(np.ascontiguousarray(samples, np.complex64), instrument, phase_sign)


def check_tones(tones: NDArray[np.float64], sample_rate: float, is_complex: bool, carrier: float) -> None:
    """Refuses tones that are not in the recording."""
    import numpy as np

    if not (np.isfinite(sample_rate) and sample_rate > 0):
        raise InputError(f"sample_rate: must be positive, not {sample_rate}")
    if carrier != 0.0 and not is_complex:
        raise InputError("carrier: only complex responses are in a base band; these are real")
    if tones.ndim != 1 or not np.isfinite(tones).all() or (tones <= 0).any():
        raise InputError("frequencies: positive tones were expected, in Hz")
    highest = float(np.abs(tones - carrier).max(initial=0.0))
    if highest >= sample_rate / 2:
        centre = f" from the carrier of {carrier:g} Hz" if carrier else ""
        raise InputError(
            f"frequencies: {highest:g} Hz{centre} is beyond half of the sample rate, {sample_rate / 2:g} Hz; the recording "
            "does not hold it"
        )


def _sent(reference: ArrayLike, sample_rate: float, tones: NDArray[np.float64]) -> NDArray[np.complex128]:
    """The spectrum of what was sent; refused where it is next to nothing, since a division would be by noise."""
    import numpy as np

    signal = np.asarray(reference)
    if signal.ndim != 1 or signal.dtype.kind not in "iufc" or not np.isfinite(signal).all():
        raise InputError("reference: one finite signal was expected, of shape [n_samples]")
    spectrum = fourier_sum(signal[None], sample_rate, tones)[:, 0]
    level = np.abs(spectrum)
    faint = level < 1e-3 * level.max(initial=0.0)
    if faint.any() or not level.any():
        tone = tones[int(np.argmax(faint))]
        raise InputError(f"reference: next to nothing was sent at {tone:g} Hz, 60 dB below the strongest tone")
    return spectrum
