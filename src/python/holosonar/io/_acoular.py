"""Acoular's recordings (HDF5) and array geometries (XML), by the command's own `import` of recordings."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import tempfile
from typing import TYPE_CHECKING, Any, Literal

from .._cubes import Cube, float64, read_array, read_cube
from .._errors import InputError
from .._run_file import PathLike, typed
from ._files import dataset, existing, opened_hdf5, read_whole, refusal
from ._responses import cube_of, from_impulse_responses

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

_WHAT = "a recording of Acoular's"

#: Samples of time that are held at once while a recording is copied.
BLOCK = 65536


def read_acoular(
    path: PathLike,
    array: PathLike,
    *,
    frequencies: ArrayLike,
    signal: Literal["tones", "broadband", "responses"],
    reference: int | None = None,
    dwell: float | None = None,
    settling: float | None = None,
    start: float = 0.0,
    latency: float | Literal["direct"] = 0.0,
    response: float | None = None,
    source: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sound_speed: float = 343.0,
) -> Cube:
    """Reads a recording of Acoular's: ``time_data`` [n_samples, n_channels] of an HDF5 file, whose ``sample_freq`` is in Hz.

    What was played is one of three. Tones one after another, or a broadband signal, are what ``holosonar import`` takes from
    WAV files, and it does the work: see the guide's chapter on measured data. Impulse responses go to
    :func:`from_impulse_responses`.

    Parameters
    ----------
    path : path
        The recording (.h5).
    array : path
        The microphones: Acoular's XML, as ``<MicArray><pos Name="1" x="0.1" y="0.2" z="0"/></MicArray>``, or CSV. Their
        coordinates are taken as ours, y pointing down.
    frequencies : array_like, shape (n_f,)
        Tones, Hz, ascending.
    signal : {"tones", "broadband", "responses"}
        What the channels hold.
    reference : int, optional
        Channel of what was sent, counted from 0; the others are the microphones in the order of ``array``. A broadband signal
        needs it; tones without it are relative to a sine of amplitude 1 that begins with each ``dwell``.
    dwell, settling : float
        How long each tone sounds, and how much of that is dropped first, s. Half of ``dwell`` if left out.
    start : float
        When the first tone begins, s; of responses, when the first sample was taken.
    latency : float or "direct"
        By how much microphones are late against the reference, s; ``"direct"`` is found from the direct wave.
    response : float, optional
        How long the room answers a broadband signal, s.
    source : (float, float, float)
        Position of the loudspeaker, m.
    sound_speed : float
        m/s.

    Returns
    -------
    Cube
        Of shape (n_f, n_mic), or (n_f, n_y, n_x) if the microphones fill a raster.

    Raises
    ------
    InputError
        Channels that are not one for each microphone; what ``import`` refuses.
    NotFoundError, ImportError
    """
    import numpy as np

    tones, positions = np.atleast_1d(float64(frequencies, "frequencies")), read_array(existing(array))
    if signal not in ("tones", "broadband", "responses"):
        raise InputError(f"signal: \"tones\", \"broadband\" or \"responses\" was expected, not {signal!r}")
    with opened_hdf5(path, _WHAT) as root:
        held = dataset(root, "time_data", path, "the recording [n_samples, n_channels]")
        rate = held.attrs.get("sample_freq")
        if rate is None or np.size(rate) != 1:
            raise refusal(path, "`time_data`: the attribute `sample_freq` is missing, Hz")
        rate = float(np.ravel(rate)[0])
        others = "" if reference is None else " besides the reference"
        expected = len(positions) + (reference is not None)
        if held.ndim != 2 or held.shape[1] != expected or held.dtype.kind not in "iuf":
            raise refusal(
                path,
                f"`time_data`: has the shape {list(held.shape)}; [n_samples, {expected}] was expected, one channel for each of "
                f"the {len(positions)} microphones of {os.fspath(array)}{others}",
            )
        if signal == "responses":
            if reference is not None or latency == "direct":
                raise InputError("signal: responses have no reference, and no latency that could be found")
            whole, since = read_whole(held, path).T, start - latency
            return from_impulse_responses(
                whole, rate, positions, source, frequencies=tones, sound_speed=sound_speed, start=since
            )
        settings = typed(
            None,
            recording__signal=signal,
            recording__reference=reference,
            recording__dwell=dwell,
            recording__settling=settling,
            recording__start=start,
            recording__latency=latency,
            recording__response=response,
            array__source=list(source),
            medium__sound_speed=sound_speed,
        )
        with tempfile.TemporaryDirectory(prefix="holosonar") as folder:
            scale = _write_wav(os.path.join(folder, "recording.wav"), held, rate, path)
            np.save(os.path.join(folder, "tones.npy"), tones)
            np.save(os.path.join(folder, "microphones.npy"), positions)
            settings += ["import.frequencies=tones.npy", "import.positions=microphones.npy"]
            _import(folder, settings, path)
            cube = read_cube(os.path.join(folder, "cube.npz"))
    # Relative to a recorded reference the scale cancels; relative to a sine of amplitude 1 it does not.
    samples = cube.samples if reference is not None else cube.samples / np.float32(scale)
    return cube_of(samples.reshape(len(tones), -1), tones, positions, source, sound_speed, "fixed-source", 1)


def _write_wav(name: str, held: Any, rate: float, path: PathLike) -> float:
    """Copies a recording into a WAV file of 32-bit floating point, at half of full scale, and gives the factor."""
    import numpy as np

    n_samples, n_channels = held.shape
    n_bytes = 4 * n_samples * n_channels
    if rate != round(rate) or not 0 < rate < 2**32:
        raise refusal(path, f"`sample_freq`: a whole number of Hz was expected, not {rate}; resample, or give responses")
    if n_bytes > 2**32 - 64 or n_channels > 16383:
        size = f"{n_bytes / 2**30:.1f} GiB in {n_channels} channels"
        raise refusal(path, f"`time_data`: {size} are more than the 4 GiB of a WAV file, which is the way; cut it")
    blocks = range(0, n_samples, BLOCK)
    loudest = max((float(np.abs(held[i : i + BLOCK].astype(np.float64)).max()) for i in blocks), default=0.0)
    if not np.isfinite(loudest) or loudest == 0.0:
        raise refusal(path, f"`time_data`: {'is 0 everywhere' if loudest == 0.0 else 'has samples that are not finite'}")
    scale = 0.5 / loudest
    whole = int(rate)
    form = struct.pack("<4sIHHIIHH", b"fmt ", 16, 3, n_channels, whole, 4 * n_channels * whole, 4 * n_channels, 32)
    with open(name, "wb") as file:
        file.write(struct.pack("<4sI4s", b"RIFF", 4 + len(form) + 8 + n_bytes, b"WAVE") + form)
        file.write(struct.pack("<4sI", b"data", n_bytes))
        for i in blocks:
            file.write((held[i : i + BLOCK] * scale).astype("<f4").tobytes())
    return scale


def _import(folder: str, settings: list[str], path: PathLike) -> None:
    """Runs `holosonar import` in a folder; what it refuses is an InputError that names the recording."""
    words = [word for setting in settings for word in ("--set", setting)]
    command = [sys.executable, "-m", "holosonar", "import", "recording.wav", "-o", "cube.npz", "-q", *words]
    package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    searched = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
    ran = subprocess.run(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": searched, "NO_COLOR": "1"}, capture_output=True, text=True
    )
    if ran.returncode:
        said = ran.stderr.strip().replace("recording.wav", "`time_data`").removeprefix("error: ")
        raise refusal(path, said or f"`holosonar import` ended with the status {ran.returncode}")
