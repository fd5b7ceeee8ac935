"""Impulse responses, MATLAB and Touchstone files become the cube that they were written from."""

import builtins
import sys

import numpy as np
import pytest
from field_formats import (
    ECHO,
    MICROPHONES,
    RATE,
    SAMPLES,
    SOUND_SPEED,
    TONES,
    echo_at,
    error,
    measured,
    responses_of,
    shows_the_echo,
)

import holosonar
from holosonar.io import from_impulse_responses, read_matlab, read_touchstone
from holosonar.io._responses import fourier_sum

pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")


def test_the_fourier_sum_is_the_literal_one():
    random = np.random.default_rng(3)
    signals = random.normal(size=(3, 2500)) + 1j * random.normal(size=(3, 2500))
    tones, start = np.array([1234.5, 9876.1, -300.0]), np.array([0.0, 0.01, -0.2])
    literal = np.zeros((3, 3), complex)
    for f, tone in enumerate(tones):
        for mic in range(3):
            for n in range(2500):
                literal[f, mic] += signals[mic, n] * np.exp(-2j * np.pi * tone * (start[mic] + n / 48e3))
    assert np.abs(fourier_sum(signals, 48e3, tones, start) - literal).max() < 1e-9
    spectrum = np.fft.rfft(signals.real, axis=1)
    bins = np.fft.rfftfreq(2500, 1 / 48e3)
    assert np.abs(fourier_sum(signals.real, 48e3, bins).T - spectrum).max() < 1e-9


@pytest.mark.parametrize("source", [(0.0, 0.0, 0.0), (0.3, 0.1, -0.05)])
def test_responses_of_a_cube_are_that_cube(source):
    cube = measured(source)
    again = from_impulse_responses(responses_of(cube), RATE, MICROPHONES.reshape(-1, 3), source, frequencies=TONES)
    assert again.shape == (41, 7, 9) and error(again, cube) < 1e-6 and shows_the_echo(again)


def test_an_echo_in_time_is_at_its_place():
    paths = np.linalg.norm(ECHO) + np.linalg.norm(MICROPHONES.reshape(-1, 3) - ECHO, axis=1)
    started = 0.002
    recorded = echo_at(paths, RATE, 4000, started - 0.0005)  # by electronics 0.5 ms late
    cube = from_impulse_responses(recorded, RATE, MICROPHONES, frequencies=TONES, start=started - 0.0005)
    assert error(cube, measured()) < 3e-3 and shows_the_echo(cube)
    # Times one each, a window that holds the echo, and a recording of a signal instead of the response.
    starts = np.full(63, started - 0.0005)
    window = np.where(np.arange(4000) < 600, 1.0, 0.0)
    windowed = from_impulse_responses(recorded, RATE, MICROPHONES, frequencies=TONES, start=starts, window=window)
    assert error(windowed, measured()) < 2e-2
    sent = np.random.default_rng(1).normal(size=1000)
    played = np.array([np.convolve(response, sent) for response in recorded])
    deconvolved = from_impulse_responses(played, RATE, MICROPHONES, frequencies=TONES, start=starts, reference=sent)
    assert error(deconvolved, cube) < 1e-6


def test_responses_in_a_base_band():
    cube = measured()
    carrier, paths = 12e3, np.linalg.norm(ECHO) + np.linalg.norm(MICROPHONES.reshape(-1, 3) - ECHO, axis=1)
    late = paths[:, None] / SOUND_SPEED
    t = np.arange(2000) / 8e3
    base = np.sinc((t - late) * 8e3) * np.exp(-2j * np.pi * carrier * late)  # of a pulse at the carrier
    again = from_impulse_responses(base, 8e3, MICROPHONES, frequencies=TONES, carrier=carrier)
    inner = slice(5, -5)  # the tones at the ends are nearly those of the Nyquist frequency
    assert np.abs(again.samples - cube.samples)[inner].max() < 2e-2 and shows_the_echo(again)


def test_microphones_in_any_order_become_rows_and_columns():
    cube, order = measured(), np.random.default_rng(2).permutation(63)
    places = MICROPHONES.reshape(-1, 3)[order] + np.random.default_rng(2).uniform(-1e-7, 1e-7, (63, 3))
    again = from_impulse_responses(responses_of(cube)[order], RATE, places, frequencies=TONES)
    assert again.shape == cube.shape and np.abs(again.samples - cube.samples).max() < 1e-6
    lacking = from_impulse_responses(responses_of(cube)[order][1:], RATE, places[1:], frequencies=TONES)
    assert lacking.shape == (41, 62) and shows_the_echo(lacking)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"responses": np.zeros((2, 63, 100))}, "responses: .*one loudspeaker|one at a time"),
        ({"responses": np.full((63, 100), np.nan)}, "responses: .*microphone 0 is not finite"),
        ({"responses": np.array([["a"]])}, "responses: numbers"),
        ({"frequencies": [10e3, 30e3]}, "30000 Hz is beyond half"),
        ({"frequencies": [0.0, 3e3]}, "positive tones"),
        ({"sample_rate": 0.0}, "sample_rate: "),
        ({"start": [0.0, 1.0]}, "start: .*63"),
        ({"window": np.ones(99)}, "window: .*100 weights"),
        ({"carrier": 1e3}, "carrier: only complex"),
        ({"reference": np.zeros(10)}, "next to nothing was sent"),
        ({"mic_positions": np.zeros((63, 2))}, "mic_positions: must have 3"),
    ],
)
def test_responses_that_are_none(change, message):
    given = {"responses": np.ones((63, 100)), "sample_rate": RATE, "mic_positions": MICROPHONES, "frequencies": TONES}
    with pytest.raises(holosonar.InputError, match=message):
        from_impulse_responses(**{**given, **change})


def test_a_library_that_is_missing_is_named(monkeypatch, tmp_path):
    (tmp_path / "cube.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(500))
    imported = builtins.__import__

    def without(name, *arguments, **words):
        if name.startswith(("scipy", "h5py", "skrf")):
            raise ImportError(name)
        return imported(name, *arguments, **words)

    for name in [name for name in sys.modules if name.startswith("scipy")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "scipy", None)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"scipy is needed.*pip install 'holosonar\[io\]'"):
        read_matlab(tmp_path / "cube.mat")


def touchstone(folder, cube, form, ports=2, to=2, sender=1, scale=1000):
    """One file for each position, by scikit-rf, named after it."""
    skrf = pytest.importorskip("skrf")
    folder.mkdir()
    frequency = skrf.Frequency.from_f(cube.instrument.frequencies, unit="hz")
    for place, m in zip(cube.instrument.mic_positions.reshape(-1, 3), cube.samples.reshape(len(TONES), -1).T.conj()):
        s = np.full((len(TONES), ports, ports), 0.1, complex)
        s[:, to - 1, sender - 1] = m
        name = f"x{scale * place[0]:g}_y{scale * place[1]:g}"
        skrf.Network(frequency=frequency, s=s, z0=50).write_touchstone(name, dir=str(folder), form=form)


@pytest.mark.parametrize("form", ["ri", "ma", "db"])
def test_touchstone_files_are_as_the_command_imports_them(tmp_path, command, form):
    cube = measured((0.2, 0.0, 0.0))
    touchstone(tmp_path / "scan", cube, form)
    pattern = str(tmp_path / "scan/x{x}_y{y}.s2p")
    read = read_touchstone(pattern, name_unit="mm", source=(0.2, 0.0, 0.0))
    assert error(read, cube) < 1e-6 and shows_the_echo(read)
    typed = ["import.name_unit=mm", "array.source=[0.2,0,0]", "medium.sound_speed=343.0"]
    words = [word for setting in typed for word in ("--set", setting)]
    command("import", pattern, "-o", tmp_path / "theirs.npz", "-q", *words)
    assert error(read, holosonar.read_cube(tmp_path / "theirs.npz")) < 1e-6


def test_touchstone_files_of_a_folder_and_of_other_ports(tmp_path):
    cube = measured()
    touchstone(tmp_path / "scan", cube, "ri", ports=3, to=3, sender=2)
    places = []
    names = sorted((tmp_path / "scan").iterdir())
    for path in names:
        x, y = path.stem[1:].split("_y")
        places.append((float(x) / 1000, float(y) / 1000, 0.0))
    read = read_touchstone(names, places, ports=(3, 2))
    assert error(read, cube) < 1e-6 and shows_the_echo(read)
    for number, path in enumerate(names):
        path.rename(path.with_name(f"point{number}.s3p"))
    assert error(read_touchstone(tmp_path / "scan", places, ports=(3, 2)), cube) < 1e-6  # 2 before 10
    with pytest.raises(holosonar.InputError, match=r"point0\.s3p: has 3 ports: say which"):
        read_touchstone(tmp_path / "scan", places)
    with pytest.raises(holosonar.InputError, match=r"has 3 ports, but `ports` are \(4, 1\)"):
        read_touchstone(tmp_path / "scan", places, ports=(4, 1))
    with pytest.raises(holosonar.InputError, match="positions: are 62, but there are 63 files"):
        read_touchstone(tmp_path / "scan", places[1:])
    with pytest.raises(holosonar.InputError, match="positions: are needed"):
        read_touchstone(tmp_path / "scan")


def test_touchstone_files_that_are_none(tmp_path):
    pytest.importorskip("skrf")
    (tmp_path / "a.s1p").write_text("# Hz S RI R 50\n1000 0.5 0\n2000 0.5 0\n")
    (tmp_path / "b.s1p").write_text("# Hz S RI R 50\n1000 0.5 0\n2001 0.5 0\n")
    with pytest.raises(holosonar.InputError, match=r"b\.s1p: its frequencies are not those of .*a\.s1p"):
        read_touchstone(tmp_path, [(0, 0, 0), (0.1, 0, 0)])
    (tmp_path / "b.s1p").write_text("nonsense\n")
    with pytest.raises(holosonar.InputError, match=r"b\.s1p: cannot be read as a Touchstone file") as wrong:
        read_touchstone(tmp_path, [(0, 0, 0), (0.1, 0, 0)])
    assert wrong.value.place.endswith("b.s1p")
    with pytest.raises(holosonar.NotFoundError, match="no such file"):
        read_touchstone([tmp_path / "gone.s1p"], [(0, 0, 0)])
    with pytest.raises(holosonar.NotFoundError, match="no file has such a name"):
        read_touchstone(str(tmp_path / "x{x}.s1p"), name_unit="m")
    with pytest.raises(holosonar.InputError, match="name_unit: one of m, cm, mm, in, ft was expected, .*, not None"):
        read_touchstone(str(tmp_path / "x{x}.s1p"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(holosonar.InputError, match="no Touchstone file"):
        read_touchstone(tmp_path / "empty", [(0, 0, 0)])
