"""MATLAB files of both kinds become the cube that they were written from; what they do not say is asked for."""

import numpy as np
import pytest
from field_formats import MICROPHONES, RATE, TONES, error, measured, responses_of, shows_the_echo

import holosonar
from holosonar.io import read_matlab

h5py = pytest.importorskip("h5py")
scipy_io = pytest.importorskip("scipy.io")
pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")


def save_old(path, variables):
    scipy_io.savemat(path, variables)


def save_new(path, variables):
    """As MATLAB writes version 7.3: HDF5 behind 512 bytes of its own, axes reversed, complex numbers as pairs."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            holder, parts = file, name
            if isinstance(value, dict):
                group = file.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for field, held in value.items():
                    dataset(group, field, held)
            else:
                dataset(holder, parts, value)
        dataset(file.create_group("#refs#"), "a", np.arange(6.0))
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")


def dataset(group, name, value):
    value = np.atleast_2d(value)
    if isinstance(value.flat[0], str):
        made = group.create_dataset(name, data=np.array([[ord(c)] for c in value.flat[0]], np.uint16))
        made.attrs["MATLAB_class"] = np.bytes_("char")
        return
    if value.dtype.kind == "c":
        pairs = np.empty(value.shape, [("real", "<f8"), ("imag", "<f8")])
        pairs["real"], pairs["imag"] = value.real, value.imag
        value = pairs
    group.create_dataset(name, data=value.T).attrs["MATLAB_class"] = np.bytes_("double")


BOTH = pytest.mark.parametrize("save", [save_old, save_new], ids=["v5", "v7.3"])


@BOTH
@pytest.mark.parametrize("axes", ["xyf", "fyx", "yfx", "fxy"])
def test_cubes_in_any_order_of_axes(tmp_path, save, axes):
    cube = measured((0.1, 0.0, 0.0))
    samples = np.transpose(cube.samples.conj(), ["fyx".index(axis) for axis in axes])
    variables = {"m": samples.astype(complex), "f": TONES / 1e3, "mics": MICROPHONES * 1e3, "note": "F of foam"}
    save(tmp_path / "scan.mat", variables)
    told = {"phase_sign": -1, "frequency_unit": 1e3, "position_unit": 1e-3, "source": (0.1, 0.0, 0.0)}
    named = read_matlab(tmp_path / "scan.mat", "m", axes=axes, frequencies="f", positions="mics", **told)
    assert error(named, cube) < 1e-6 and shows_the_echo(named)
    found = read_matlab(tmp_path / "scan.mat", **told)  # 41, 7 and 9 leave one order of axes
    assert np.array_equal(found.samples, named.samples)
    turned = read_matlab(tmp_path / "scan.mat", **{**told, "phase_sign": 1})
    with pytest.raises(AssertionError, match="the other sign"):
        shows_the_echo(turned)


@BOTH
def test_scattered_microphones_in_a_structure(tmp_path, save):
    places = holosonar.random_array(60, 0.4, seed=4)
    cube = measured(microphones=places)
    save(tmp_path / "scan.mat", {"s": {"m": cube.samples.T.astype(complex), "f": TONES[None], "r": places.T}, "gain": 3.0})
    read = read_matlab(tmp_path / "scan.mat", phase_sign=1)
    assert read.shape == (41, 60) and error(read, cube) < 1e-6 and shows_the_echo(read)
    again = read_matlab(tmp_path / "scan.mat", "s.m", axes=["mic", "f"], frequencies=TONES, positions=places, phase_sign=1)
    assert np.array_equal(again.samples, read.samples)


@BOTH
def test_in_phase_and_quadrature_apart(tmp_path, save):
    cube = measured()
    save(tmp_path / "iq.mat", {"I": cube.samples.real, "Q": cube.samples.imag, "f": TONES, "r": MICROPHONES})
    read = read_matlab(tmp_path / "iq.mat", ("I", "Q"), positions="r", phase_sign=1)
    assert error(read, cube) < 1e-6 and shows_the_echo(read)
    with pytest.raises(holosonar.InputError, match="`I`, `f`: real I and Q of the same shape were expected; the file has"):
        read_matlab(tmp_path / "iq.mat", ("I", "f"), positions="r", phase_sign=1)


@BOTH
def test_responses_over_time(tmp_path, save):
    cube = measured()
    responses = responses_of(cube).reshape(7, 9, -1).transpose(2, 1, 0)  # [t, x, y]
    save(tmp_path / "ir.mat", {"h": responses, "fs": RATE, "r": MICROPHONES})
    read = read_matlab(tmp_path / "ir.mat", "h", axes=["t", "x", "y"], frequencies=TONES, sample_rate="fs")
    assert error(read, cube) < 1e-6 and shows_the_echo(read)
    late = read_matlab(tmp_path / "ir.mat", "h", axes="txy", frequencies=TONES, sample_rate=RATE, start=-0.001)
    turn = np.exp(-2j * np.pi * TONES * 0.001)[:, None, None]
    assert np.abs(late.samples - cube.samples * turn).max() < 1e-6
    with pytest.raises(holosonar.InputError, match="need `frequencies`, the tones, and `sample_rate`"):
        read_matlab(tmp_path / "ir.mat", "h", axes=["t", "x", "y"], sample_rate="fs")


def test_a_single_row_of_microphones(tmp_path):
    row = MICROPHONES[3]
    cube = measured(microphones=row)
    save_old(tmp_path / "row.mat", {"m": cube.samples[:, None, :].astype(complex), "f": TONES, "r": row})
    read = read_matlab(tmp_path / "row.mat", axes=["f", "-", "x"], phase_sign=1)
    assert np.abs(read.samples - cube.samples).max() < 1e-6


@BOTH
@pytest.mark.parametrize(
    ("change", "told", "message"),
    [
        ({}, {"phase_sign": None}, "`m`: phase_sign must be -1 if phases fall"),
        ({}, {"samples": "n"}, r"`n`, the samples, is missing; the file has .*m \(complex128 \[41, 7, 9\]\)"),
        ({"n": np.ones((4, 5)) + 1j}, {}, r"2 variables could be the samples; name it with `samples`; the file has"),
        ({"m": np.ones((41, 7, 9))}, {}, "no variable can be the samples"),
        ({"m": np.ones((41, 7, 9))}, {"samples": "m"}, "`m`: complex samples were expected"),
        ({"f": np.arange(5.0)}, {}, "no variable can be the frequencies: ascending"),
        ({"g": TONES}, {}, "2 variables could be the frequencies"),
        ({"r": 1.0}, {}, "no variable can be the microphones' positions"),
        ({"r": np.ones((3, 62))}, {}, "`m`: no order of axes fits"),
        ({"r": MICROPHONES.reshape(-1, 3)}, {"axes": "fyx"}, r"positions \[n_y, n_x, 3\] are needed"),
        ({}, {"axes": "fxy"}, r'shape \[41, 7, 9\], which is not that of the axes "f" 41, "x" 9, "y" 7'),
        ({}, {"axes": "fq"}, "axes: .*are none of"),
        ({"f": np.ones((3, 2))}, {"frequencies": "f"}, "`f`: a vector of frequencies"),
        ({"r": np.ones((4, 4))}, {"positions": "r"}, "`r`: positions"),
        ({}, {"start": 0.1}, "`start` is of responses over time"),
    ],
)
def test_what_a_file_does_not_say_is_asked_for(tmp_path, save, change, told, message):
    variables = {"m": measured().samples.astype(complex), "f": TONES, "r": MICROPHONES}
    save(tmp_path / "scan.mat", {**variables, **change})
    with pytest.raises(holosonar.InputError, match=message) as wrong:
        read_matlab(tmp_path / "scan.mat", **{"phase_sign": 1, **told})
    assert "axes: " in str(wrong.value)[:6] or wrong.value.place.endswith("scan.mat")


def test_files_that_are_none_of_matlabs(tmp_path):
    with pytest.raises(holosonar.NotFoundError, match=r"gone\.mat: no such file"):
        read_matlab(tmp_path / "gone.mat")
    save_old(tmp_path / "empty.mat", {"note": "nothing"})
    with pytest.raises(holosonar.InputError, match="has no numeric arrays"):
        read_matlab(tmp_path / "empty.mat")
    for number, damage in enumerate([b"", b"nonsense" * 100, b"\x89HDF\r\n\x1a\n" + bytes(600)]):
        (tmp_path / f"{number}.mat").write_bytes(damage)
        with pytest.raises(holosonar.InputError, match=rf"{number}\.mat: cannot be read as|has no numeric"):
            read_matlab(tmp_path / f"{number}.mat")
    # Cut short anywhere. That damaged bytes within are noticed is the libraries' affair, and SciPy does not notice all of them.
    for save in (save_old, save_new):
        save(tmp_path / "whole.mat", {"m": measured().samples[:3].astype(complex), "f": TONES[:3], "r": MICROPHONES})
        whole = (tmp_path / "whole.mat").read_bytes()
        for length in np.linspace(1, len(whole) - 1, 25).astype(int):
            (tmp_path / "cut.mat").write_bytes(whole[:length])
            with pytest.raises(holosonar.InputError, match=r"cut\.mat: "):
                read_matlab(tmp_path / "cut.mat", phase_sign=1)
