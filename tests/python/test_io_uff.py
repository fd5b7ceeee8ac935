"""USTB's ultrasound file format, written by PyUFF, becomes the cube of the echoes that are in it."""

import numpy as np
import pytest
from field_formats import ECHO, MICROPHONES, RATE, SOUND_SPEED, TONES, echo_at, error, measured, shows_the_echo

import holosonar
from holosonar.io import read_uff

pyuff = pytest.importorskip("pyuff_ustb")
h5py = pytest.importorskip("h5py")
pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")

ELEMENTS = MICROPHONES.reshape(-1, 3)
SAMPLES = 1200


def point(place):
    x, y, z = place
    distance = float(np.linalg.norm(place))
    elevation = float(np.arcsin(y / distance)) if distance else 0.0
    return pyuff.Point(distance=distance, azimuth=float(np.arctan2(x, z)), elevation=elevation)


def wave(source, delay=0.0, kind=None):
    return pyuff.Wave(
        wavefront=kind or pyuff.Wavefront.spherical,
        source=point(source),
        origin=point((0.0, 0.0, 0.0)),
        sound_speed=SOUND_SPEED,
        delay=delay,
    )


def when_heard(source, delay, places=ELEMENTS):
    """Times in the file at which USTB's beamformer looks for ECHO: by source and element, s.

    The wave passes the origin at time 0, `delay` earlier than the acquisition begins: from behind the probe the distance from
    source to origin is taken away, and in the plane of the probe it is added.
    """
    away = np.linalg.norm(source)
    passing = -away if source[2] < -1e-3 else away
    sent = (np.linalg.norm(np.subtract(ECHO, source)) + passing) / SOUND_SPEED - delay
    return sent + np.linalg.norm(places - ECHO, axis=1) / SOUND_SPEED


def write(path, signals, waves, first, **changes):
    """Channel data [n_samples, n_elements, n_waves(, n_frames)]."""
    geometry = np.vstack([ELEMENTS.T, np.zeros((4, len(ELEMENTS)))])
    fields = {
        "data": signals,
        "probe": pyuff.Probe(geometry=geometry, origin=point((0.0, 0.0, 0.0))),
        "sequence": waves,
        "sampling_frequency": RATE,
        "initial_time": first,
        "sound_speed": SOUND_SPEED,
        "modulation_frequency": 0.0,
        **changes,
    }
    data = pyuff.ChannelData(**fields)
    data.write(str(path), "channel_data", ignore_missing_compulsory_fields=True)


def heard(source, delay, first):
    return echo_at(when_heard(source, delay) * SOUND_SPEED, RATE, SAMPLES, first)


@pytest.mark.parametrize("source", [(0.0, 0.0, 0.0), (0.2, 0.1, -0.3), (0.1, -0.05, 0.0)])
def test_one_spherical_wave(tmp_path, source):
    delay, first = 2e-4, -1e-3
    write(tmp_path / "one.uff", heard(source, delay, first).T, wave(source, delay), first)
    cube = read_uff(tmp_path / "one.uff", frequencies=TONES)
    assert error(cube, measured(source)) < 3e-3 and shows_the_echo(cube)


@pytest.mark.parametrize("chunks", [None, (2, 63, 63, SAMPLES)], ids=["contiguous", "one chunk"])
def test_one_wave_from_each_element(tmp_path, chunks):
    # Time 0 is when the wave leaves the element, as simulators write it.
    delays = np.linalg.norm(ELEMENTS, axis=1) / SOUND_SPEED
    order = np.random.default_rng(1).permutation(len(ELEMENTS))
    signals = np.stack([heard(ELEMENTS[e], delays[e], 0.001) for e in order], axis=-1).transpose(1, 0, 2)
    frames = np.stack([np.zeros_like(signals), signals], axis=-1)
    write(tmp_path / "all.uff", frames, [wave(ELEMENTS[e], delays[e]) for e in order], 0.001)
    with h5py.File(tmp_path / "all.uff", "r+") as file:
        del file["channel_data/data"]
        file.create_dataset("channel_data/data", data=frames.T, chunks=chunks)
    cube = read_uff(tmp_path / "all.uff", frequencies=TONES, monostatic=True, frame=1)
    assert error(cube, measured(geometry="monostatic")) < 3e-3 and shows_the_echo(cube)
    number = 5
    cube = read_uff(tmp_path / "all.uff", frequencies=TONES, wave=number, frame=1)
    assert error(cube, measured(tuple(ELEMENTS[order[number]]))) < 3e-3 and shows_the_echo(cube)
    with pytest.raises(holosonar.InputError, match=r"has 63 waves: wave=0 takes the first; monostatic=True"):
        read_uff(tmp_path / "all.uff", frequencies=TONES)
    with pytest.raises(holosonar.InputError, match="has 63 waves; wave=63 counts from 0"):
        read_uff(tmp_path / "all.uff", frequencies=TONES, wave=63)
    with pytest.raises(holosonar.InputError, match="wave: monostatic=True takes the waves of all"):
        read_uff(tmp_path / "all.uff", frequencies=TONES, wave=0, monostatic=True)
    with pytest.raises(holosonar.InputError, match="has 2 frames; frame=2"):
        read_uff(tmp_path / "all.uff", frequencies=TONES, wave=0, frame=2)


def test_data_in_a_base_band(tmp_path):
    source, delay, first, carrier, rate = (0.1, 0.0, -0.2), 1e-4, 5e-4, 12e3, 8e3
    times = when_heard(source, delay)
    t = first + np.arange(400) / rate
    base = np.sinc((t - times[:, None]) * rate) * np.exp(-2j * np.pi * carrier * times[:, None])
    changes = {"sampling_frequency": rate, "modulation_frequency": carrier}
    write(tmp_path / "iq.uff", base.T, wave(source, delay), first, **changes)
    cube = read_uff(tmp_path / "iq.uff", frequencies=TONES)
    inner = slice(5, -5)
    assert np.abs(cube.samples - measured(source).samples)[inner].max() < 2e-2 and shows_the_echo(cube)
    with pytest.raises(holosonar.InputError, match="from the carrier of 12000 Hz is beyond half of the sample rate, 4000 Hz"):
        read_uff(tmp_path / "iq.uff", frequencies=[7e3, 10e3])


def test_the_file_says_what_pyuff_reads(tmp_path):
    write(tmp_path / "one.uff", heard((0, 0, 0), 0.0, 0.0).T, wave((0, 0, 0)), 0.0)
    cube = read_uff(tmp_path / "one.uff", frequencies=TONES)
    theirs = pyuff.Uff(str(tmp_path / "one.uff")).read("channel_data")
    assert np.allclose(np.sort(cube.instrument.mic_positions.reshape(-1, 3), axis=0), np.sort(theirs.probe.xyz, axis=0))
    assert cube.instrument.sound_speed == theirs.sound_speed == SOUND_SPEED
    assert read_uff(tmp_path / "one.uff", frequencies=TONES, sound_speed=340.0).instrument.sound_speed == 340.0


def test_files_that_have_no_such_waves(tmp_path):
    signals = heard((0, 0, 0), 0.0, 0.0).T
    for name, sent, message in (
        ("plane", wave((0, 0, 0), kind=pyuff.Wavefront.plane), "a spherical wave was expected; plane"),
        ("focused", wave((0, 0, 0.5)), "is focused at z = 0.5 m"),
    ):
        write(tmp_path / f"{name}.uff", signals, sent, 0.0)
        with pytest.raises(holosonar.InputError, match=rf"{name}\.uff: `channel_data/sequence`: {message}"):
            read_uff(tmp_path / f"{name}.uff", frequencies=TONES)
    write(tmp_path / "few.uff", np.stack([signals] * 2, axis=-1), [wave(ELEMENTS[0]), wave(ELEMENTS[1])], 0.0)
    with pytest.raises(holosonar.InputError, match="no wave is from element 2, which monostatic=True needs"):
        read_uff(tmp_path / "few.uff", frequencies=TONES, monostatic=True)


@pytest.mark.parametrize(
    ("gone", "message"),
    [
        ("channel_data", "`channel_data` is missing, the channel data; in / there is nothing"),
        ("channel_data/sampling_frequency", "`sampling_frequency` is missing, Hz; in /channel_data there is data, initial_time"),
        ("channel_data/probe/geometry", "`geometry` is missing, x, y, z of each element"),
        ("channel_data/sequence", "`sequence` is missing, the waves"),
        ("channel_data/sequence/source", "`source` is missing, the point"),
        ("channel_data/data", r"`data` is missing, \[sample, element, wave, frame\]; in /channel_data"),
    ],
)
def test_files_that_lack_something(tmp_path, gone, message):
    path = tmp_path / "one.uff"
    write(path, heard((0, 0, 0), 0.0, 0.0).T, wave((0, 0, 0)), 0.0)
    with h5py.File(path, "r+") as file:
        del file[gone]
    with pytest.raises(holosonar.InputError, match=message) as wrong:
        read_uff(path, frequencies=TONES)
    assert wrong.value.place == str(path)


def test_data_of_another_shape(tmp_path):
    path = tmp_path / "one.uff"
    write(path, heard((0, 0, 0), 0.0, 0.0).T[:, :62], wave((0, 0, 0)), 0.0)
    with pytest.raises(holosonar.InputError, match=r"shape \[1200, 62\]; \[sample, 63 elements, 1 waves, frame\]"):
        read_uff(path, frequencies=TONES)
    path.write_bytes(b"nothing")
    with pytest.raises(holosonar.InputError, match="cannot be read as HDF5, which a file of USTB's"):
        read_uff(path, frequencies=TONES)
