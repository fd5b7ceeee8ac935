"""Acoular's recordings and geometries become the cube of what was played and heard."""

import field_formats
import numpy as np
import pytest
from field_formats import ECHO, MICROPHONES, SOUND_SPEED, echo_at, error, responses_of, shows_the_echo

import holosonar
from holosonar.io import read_acoular

h5py = pytest.importorskip("h5py")
pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")

RATE = 51_200
PLACES = MICROPHONES[::2, ::2].reshape(-1, 3)
TONES = holosonar.stepped_frequencies(10e3, 14e3, 200.0)
PATHS = np.linalg.norm(ECHO) + np.linalg.norm(PLACES - ECHO, axis=1)


def geometry(folder, places=PLACES):
    """As Acoular writes it."""
    rows = [f'    <pos Name="Point {i}" x="{x}" y="{y}" z="{z}"/>' for i, (x, y, z) in enumerate(places)]
    path = folder / "array.xml"
    path.write_text('<?xml version="1.1" encoding="utf-8"?>\n<MicArray name="array">\n' + "\n".join(rows) + "\n</MicArray>\n")
    return path


def recording(folder, channels, rate=RATE):
    """Channels [n_samples, n_channels], as Acoular writes them."""
    path = folder / "recording.h5"
    with h5py.File(path, "w") as file:
        held = file.create_dataset("time_data", data=np.asarray(channels, np.float32), chunks=True)
        held.attrs["sample_freq"] = float(rate)
    return path


def expected():
    instrument = holosonar.Instrument(TONES, MICROPHONES[::2, ::2], SOUND_SPEED)
    return holosonar.simulate(holosonar.Reflectors([ECHO]), instrument)


@pytest.mark.parametrize("reference", [None, 3])
def test_stepped_tones(tmp_path, reference):
    dwell, loud = 0.02, 40.0  # Pa, far above a converter's full scale of 1
    t = np.arange(int(dwell * RATE)) / RATE
    heard, sent = [], []
    for tone in TONES:
        heard.append(loud * np.sin(2 * np.pi * tone * (t[:, None] - PATHS / SOUND_SPEED)))
        sent.append(0.5 * np.sin(2 * np.pi * tone * t))
    channels = np.concatenate(heard)
    amplitude = loud
    if reference is not None:
        channels = np.insert(channels, reference, np.concatenate(sent), axis=1)
        amplitude = loud / 0.5
    cube = read_acoular(
        recording(tmp_path, channels), geometry(tmp_path), frequencies=TONES, signal="tones", dwell=dwell, reference=reference
    )
    scaled = holosonar.Cube(cube.samples / np.float32(amplitude), cube.instrument)
    assert error(scaled, expected()) < 1e-4 and shows_the_echo(scaled)


def test_a_chirp_with_its_reference(tmp_path):
    t = np.arange(RATE) / RATE

    def chirp(t):
        edge = np.clip(np.minimum(t, 0.5 - t) / 0.02, 0, 1)
        return np.square(np.sin(np.pi / 2 * edge)) * np.sin(2 * np.pi * (8e3 + 8e3 * t) * t)

    channels = np.stack([*(0.25 * chirp(t - path / SOUND_SPEED) for path in PATHS), 0.5 * chirp(t)], axis=1)
    cube = read_acoular(
        recording(tmp_path, channels), geometry(tmp_path), frequencies=TONES, signal="broadband", reference=len(PLACES),
        response=0.02,
    )  # fmt: skip
    halved = holosonar.Cube(cube.samples / np.float32(0.5), cube.instrument)
    assert error(halved, expected()) < 2e-3 and shows_the_echo(halved)


def test_responses(tmp_path):
    channels = echo_at(PATHS, RATE, 2000, -0.001).T
    array = geometry(tmp_path)
    cube = read_acoular(recording(tmp_path, channels), array, frequencies=TONES, signal="responses", start=-0.001)
    assert error(cube, expected()) < 3e-3 and shows_the_echo(cube)
    late = read_acoular(recording(tmp_path, channels), array, frequencies=TONES, signal="responses", latency=0.001)
    assert np.abs(late.samples - cube.samples).max() < 1e-6


def test_scattered_microphones(tmp_path):
    places = holosonar.random_array(30, 0.4, seed=4)
    cube = field_formats.measured(microphones=places)
    path = recording(tmp_path, responses_of(cube).T, field_formats.RATE)
    read = read_acoular(path, geometry(tmp_path, places), frequencies=field_formats.TONES, signal="responses")
    assert error(read, cube) < 1e-6 and shows_the_echo(read)


@pytest.mark.parametrize(
    ("change", "told", "message"),
    [
        ({}, {"signal": "noise"}, 'signal: "tones", "broadband" or "responses"'),
        ({"channels": np.ones((99, 19))}, {}, r"`time_data`: .*\[99, 19\]; \[n_samples, 20\] .* 20 microphones of .*array\.xml"),
        ({}, {"reference": 0}, r"\[n_samples, 21\] .* besides the reference"),
        ({"rate": 51200.5}, {}, "`sample_freq`: a whole number of Hz"),
        ({"channels": np.zeros((99, 20))}, {}, "`time_data`: is 0 everywhere"),
        ({"channels": np.full((99, 20), np.nan)}, {}, "`time_data`: has samples that are not finite"),
        ({}, {"dwell": None}, "recording.h5: .*dwell"),
        ({}, {"dwell": 3.0}, "recording.h5: .*`time_data`"),
        ({}, {"signal": "broadband"}, "recording.h5: .*reference"),
        ({}, {"signal": "responses", "latency": "direct"}, "responses have no reference, and no latency"),
    ],
)
def test_what_a_recording_does_not_hold(tmp_path, change, told, message):
    path = recording(tmp_path, **{"channels": np.random.default_rng(1).normal(size=(9999, 20)), **change})
    with pytest.raises(holosonar.InputError, match=message):
        read_acoular(path, geometry(tmp_path), **{"frequencies": TONES, "signal": "tones", "dwell": 0.004, **told})


def test_files_that_are_none_of_acoulars(tmp_path):
    array, told = geometry(tmp_path), {"frequencies": TONES, "signal": "tones", "dwell": 0.004}
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["pressure"] = np.ones((5, 20))
    with pytest.raises(holosonar.InputError, match=r"other\.h5: `time_data` is missing, .* in / there is pressure"):
        read_acoular(path, array, **told)
    with h5py.File(path, "w") as file:
        file["time_data"] = np.ones((5, 20))
    with pytest.raises(holosonar.InputError, match="`sample_freq` is missing, Hz"):
        read_acoular(path, array, **told)
    with pytest.raises(holosonar.NotFoundError, match=r"gone\.xml: no such file"):
        read_acoular(path, tmp_path / "gone.xml", **told)
    array.write_text("<html/>")
    with pytest.raises(holosonar.InputError, match=r"array\.xml"):
        read_acoular(path, array, **told)
