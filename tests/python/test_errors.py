"""Exceptions: one class for each kind, with a message that says what to do."""

import pickle

import numpy as np
import pytest

import holosonar


@pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")
def test_kinds_are_also_pythons(tmp_path, instrument):
    with pytest.raises(FileNotFoundError) as missing:
        holosonar.read_cube(tmp_path / "gone.npz")
    assert isinstance(missing.value, holosonar.NotFoundError) and isinstance(missing.value, OSError)
    assert missing.value.place.endswith("gone.npz") and missing.value.errno == 2
    assert str(missing.value).endswith("gone.npz: no such file; check the path")
    with pytest.raises(ValueError) as wrong:
        holosonar.RunFile(set={"sweep.steps": 3})
    assert isinstance(wrong.value, holosonar.InputError) and "`step`" in str(wrong.value)
    grid = holosonar.Grid.spanning(x=(-1, 1), y=(-1, 1), z=(1, 2), pitch=0.001)
    cube = holosonar.Cube(np.ones(instrument.shape, np.complex64), instrument)
    with pytest.raises(MemoryError) as full:
        holosonar.reconstruct(cube, grid, memory="100MB")
    assert isinstance(full.value, holosonar.MemoryLimitError) and full.value.place == "memory"
    assert isinstance(full.value, holosonar.OutOfMemoryError) and isinstance(full.value, holosonar.InputError)
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError) as refused:
        cube.write(tmp_path / "file/cube.npz")
    assert isinstance(refused.value, holosonar.HolosonarError)


def test_exceptions_can_be_pickled():
    with pytest.raises(holosonar.InputError) as wrong:
        holosonar.stepped_frequencies(10e3, 20e3, 30.0)
    again = pickle.loads(pickle.dumps(wrong.value))
    assert str(again) == str(wrong.value) and again.place == wrong.value.place == "sweep"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frequencies": [2.0, 1.0]}, "frequencies: .*ascend"),
        ({"frequencies": []}, "frequencies: "),
        ({"mic_positions": [[0.0, 0.0]]}, "mic_positions: must have 3 coordinates"),
        ({"mic_positions": [[np.nan, 0.0, 0.0]]}, "mic_positions: "),
        ({"geometry": "bistatic"}, "geometry: .*fixed-source, monostatic"),
        ({"detection": "real"}, "detection: .*quadrature, in-phase"),
        ({"sound_speed": -1.0}, "speed of sound"),
    ],
)
def test_instruments_that_are_none(instrument, change, message):
    parts = {"frequencies": instrument.frequencies, "mic_positions": instrument.mic_positions, **change}
    with pytest.raises(holosonar.InputError, match=message):
        holosonar.Instrument(**parts)


def test_samples_that_do_not_fit(instrument, grid):
    with pytest.raises(holosonar.InputError, match="samples: have the shape"):
        holosonar.Cube(np.ones((3, 4), np.complex64), instrument)
    samples = np.ones(instrument.shape, np.complex64)
    samples[3, 1, 2] = np.nan
    with pytest.raises(holosonar.InputError, match="not finite at frequency 3 .*microphone 11"):
        holosonar.reconstruct(holosonar.Cube(samples, instrument), grid)
    fine = holosonar.Cube(np.ones(instrument.shape, np.complex64), instrument)
    with pytest.raises(holosonar.InputError, match=r"\[grid\].*x, y and z"):
        holosonar.reconstruct(fine)
    with pytest.raises(holosonar.InputError, match="grid.x: needs"):
        holosonar.reconstruct(fine, holosonar.Grid(holosonar.Axis(0, 0, 3), grid.y, grid.z))
    with pytest.raises(holosonar.InputError, match="reconstruct.window.*hamming.*hann"):
        holosonar.reconstruct(fine, grid, window="hamming")
    with pytest.raises(holosonar.InputError, match=r"\.npz"):
        fine.write("cube.txt")


def test_a_damaged_file_makes_no_noise(tmp_path, capfd):
    (tmp_path / "damaged.npz").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(holosonar.InputError):
        holosonar.read_cube(tmp_path / "damaged.npz")
    assert capfd.readouterr().err == ""
