"""SOFA files, written by sofar, become the cube that they were written from."""

import numpy as np
import pytest
from field_formats import MICROPHONES, RATE, SAMPLES, TONES, error, measured, responses_of, shows_the_echo

import holosonar
from holosonar.io import read_sofa

sofar = pytest.importorskip("sofar")
h5py = pytest.importorskip("h5py")
pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")

PLACES = MICROPHONES.reshape(-1, 3)
SOURCE = np.array([0.3, 0.1, -0.05])


def in_sofa(points):
    """Ours to SOFA's axes: x ahead, y to the left, z up."""
    x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
    return np.stack([z, -x, -y], axis=-1)


def spherical(points):
    x, y, z = np.moveaxis(points, -1, 0)
    radius = np.linalg.norm(points, axis=-1)
    return np.stack([np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arcsin(z / radius)), radius], axis=-1)


def of_responses(responses, receivers, source, delay=None):
    """Responses [M, R, N], receivers [R, 3] and source [M or 1, 3] in SOFA's axes, m."""
    sofa = sofar.Sofa("GeneralFIR")
    sofa.Data_IR, sofa.Data_SamplingRate = responses, RATE
    sofa.Data_Delay = np.zeros((1, responses.shape[1])) if delay is None else delay
    sofa.ReceiverPosition = receivers
    sofa.SourcePosition, sofa.SourcePosition_Type, sofa.SourcePosition_Units = source, "cartesian", "metre"
    return sofa


def write(path, sofa):
    sofar.write_sofa(str(path), sofa)
    return path


@pytest.mark.parametrize("places", ["cartesian", "spherical", "turned", "rolled", "moved"])
def test_responses_of_an_array(tmp_path, places):
    cube = measured(tuple(SOURCE))
    receivers, source = in_sofa(PLACES), in_sofa(SOURCE)[None]
    sofa = of_responses(responses_of(cube)[None], receivers, source)
    if places == "spherical":
        sofa.SourcePosition, sofa.SourcePosition_Type = spherical(source), "spherical"
        sofa.SourcePosition_Units = "degree, degree, metre"
        receivers = receivers + [0.5, 0.0, 0.0]  # the array's centre has no direction
        sofa.ReceiverPosition, sofa.ReceiverPosition_Type = spherical(receivers), "spherical"
        sofa.ReceiverPosition_Units = "degree, degree, metre"
        sofa.ListenerPosition = [[-0.5, 0.0, 0.0]]
    elif places == "turned":
        # The listener looks to the left: what is ahead of it, x, is y of the file, and its left is -x.
        sofa.ListenerView = [[0.0, 2.0, 0.0]]
        sofa.ReceiverPosition = np.stack([receivers[:, 1], -receivers[:, 0], receivers[:, 2]], axis=-1)
    elif places == "rolled":
        # Its up is to the left, y: its left is down, -z.
        sofa.add_variable("ListenerUp", [[0.0, 1.0, 0.0]], "double", "IC")
        sofa.ReceiverPosition = np.stack([receivers[:, 0], -receivers[:, 2], receivers[:, 1]], axis=-1)
    elif places == "moved":
        sofa.ListenerPosition = [[0.1, 0.2, 0.3]]
        sofa.ReceiverPosition = receivers - [0.1, 0.2, 0.3]
    cubes = read_sofa(write(tmp_path / "array.sofa", sofa), frequencies=TONES)
    assert error(cubes, cube) < 1e-6 and shows_the_echo(cubes)


def test_delays_and_latency_are_part_of_the_paths(tmp_path):
    cube = measured(tuple(SOURCE))
    delay = np.random.default_rng(1).uniform(3, 9, (1, 63))  # samples that the responses are cut short by
    spectrum = np.fft.rfft(responses_of(cube), axis=1)
    f = np.fft.rfftfreq(SAMPLES, 1 / RATE)
    early = np.fft.irfft(spectrum * np.exp(2j * np.pi * f * (delay.T / RATE - 0.001)), SAMPLES, axis=1)
    path = write(tmp_path / "late.sofa", of_responses(early[None], in_sofa(PLACES), in_sofa(SOURCE)[None], delay))
    read = read_sofa(path, frequencies=TONES, latency=0.001)
    assert error(read, cube) < 1e-6 and shows_the_echo(read)


def test_transfer_functions(tmp_path):
    cube = measured(tuple(SOURCE))
    sofa = sofar.Sofa("GeneralTF")
    spectrum = np.zeros((1, 63, 42), complex)
    spectrum[0, :, 1:] = cube.samples.reshape(41, -1).T.conj()
    sofa.Data_Real, sofa.Data_Imag = spectrum.real, spectrum.imag
    sofa.N, sofa.N_Units = np.concatenate([[0.0], TONES]), "hertz"
    sofa.ReceiverPosition = PLACES
    sofa.SourcePosition, sofa.SourcePosition_Type, sofa.SourcePosition_Units = SOURCE[None], "cartesian", "metre"
    path = write(tmp_path / "tf.sofa", sofa)
    read = read_sofa(path, frame="array")
    assert error(read, cube) < 1e-6 and shows_the_echo(read)
    assert np.array_equal(read_sofa(path, frame="array", frequencies=TONES[::4]).samples, read.samples[::4])
    with pytest.raises(holosonar.InputError, match="`N`: 10050 Hz is none of its 42 frequencies, 0 to 14000 Hz"):
        read_sofa(path, frequencies=[10e3, 10050.0])
    late = read_sofa(path, frame="array", latency=1e-3)
    assert np.abs(late.samples - read.samples * np.exp(-2j * np.pi * TONES * 1e-3)[:, None, None]).max() < 1e-6


def test_one_microphone_that_is_moved(tmp_path):
    cube = measured(tuple(SOURCE))
    sofa = of_responses(responses_of(cube)[:, None], np.zeros((1, 3)), in_sofa(SOURCE)[None])
    sofa.ListenerPosition = in_sofa(PLACES)
    path = write(tmp_path / "moved.sofa", sofa)
    read = read_sofa(path, frequencies=TONES)
    assert error(read, cube) < 1e-6 and shows_the_echo(read)
    one = read_sofa(path, frequencies=TONES, measurement=7)
    assert one.shape == (41, 1) and np.array_equal(one.samples[:, 0], read.samples.reshape(41, -1)[:, 7])
    # With its loudspeaker, it is a monostatic scan.
    both = measured(geometry="monostatic")
    sofa.Data_IR, sofa.SourcePosition = responses_of(both)[:, None], in_sofa(PLACES)
    scan = read_sofa(write(tmp_path / "scan.sofa", sofa), frequencies=TONES)
    assert error(scan, both) < 1e-6 and shows_the_echo(scan)


def test_several_loudspeakers_are_taken_one_by_one(tmp_path):
    sources = np.array([SOURCE, -SOURCE])
    cubes = [measured(tuple(source)) for source in sources]
    responses = np.stack([responses_of(cube) for cube in cubes])
    path = write(tmp_path / "two.sofa", of_responses(responses, in_sofa(PLACES), in_sofa(sources)))
    for number, cube in enumerate(cubes):
        assert error(read_sofa(path, frequencies=TONES, measurement=number), cube) < 1e-6
    with pytest.raises(holosonar.InputError, match="has 2 measurements from sources that differ: measurement=0 takes"):
        read_sofa(path, frequencies=TONES)
    with pytest.raises(holosonar.InputError, match="has 2 measurements; measurement=2 counts from 0"):
        read_sofa(path, frequencies=TONES, measurement=2)
    # Two emitters about one source, which faces the array from the side.
    sofa = sofar.Sofa("GeneralFIR-E")
    sofa.Data_IR, sofa.Data_SamplingRate = responses.transpose(1, 2, 0)[None], RATE
    sofa.Data_Delay = np.zeros((1, 63, 2))
    sofa.ReceiverPosition = in_sofa(PLACES)
    sofa.SourcePosition, sofa.SourcePosition_Type, sofa.SourcePosition_Units = [[0.0, 0.0, 0.0]], "cartesian", "metre"
    sofa.EmitterPosition = in_sofa(sources)
    path = write(tmp_path / "emitters.sofa", sofa)
    for number, cube in enumerate(cubes):
        assert error(read_sofa(path, frequencies=TONES, emitter=number), cube) < 1e-6
    with h5py.File(path, "r+") as file:  # the same in the order of the older type
        del file["Data.IR"]
        file["Data.IR"], file.attrs["DataType"] = responses.transpose(1, 0, 2)[None], np.bytes_("FIRE")
    assert error(read_sofa(path, frequencies=TONES, emitter=1), cubes[1]) < 1e-6
    with pytest.raises(holosonar.InputError, match="has 2 emitters: emitter=0 takes the first"):
        read_sofa(path, frequencies=TONES)


def test_what_cannot_be_read(tmp_path):
    path = write(tmp_path / "a.sofa", of_responses(np.zeros((1, 63, 8)), in_sofa(PLACES), in_sofa(SOURCE)[None]))
    with pytest.raises(holosonar.InputError, match="`Data.IR`: impulse responses need `frequencies`"):
        read_sofa(path)
    with pytest.raises(holosonar.InputError, match='frame: "sofa" or "array"'):
        read_sofa(path, frequencies=TONES, frame="ours")
    changes = {
        "`ReceiverPosition`: cartesian in metre, or spherical .* was expected, not cartesian in inch": (
            lambda file: file["ReceiverPosition"].attrs.__setitem__("Units", np.bytes_("inch"))
        ),
        "`Data.SamplingRate`: one rate in hertz": lambda file: file["Data.SamplingRate"].attrs.__setitem__("Units", b"kHz"),
        "`SourcePosition` is missing": lambda file: file.__delitem__("SourcePosition"),
        "`Data.IR`, or `Data.Real` and `Data.Imag`, were expected; the DataType is 'FIR'": (
            lambda file: file.__delitem__("Data.IR")
        ),
    }
    whole = path.read_bytes()
    for message, change in changes.items():
        path.write_bytes(whole)
        with h5py.File(path, "r+") as file:
            change(file)
        with pytest.raises(holosonar.InputError, match=rf"a\.sofa: {message}"):
            read_sofa(path, frequencies=TONES)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(holosonar.InputError, match=r"a\.sofa: cannot be read as HDF5, which a SOFA file is"):
        read_sofa(path, frequencies=TONES)
    with pytest.raises(holosonar.NotFoundError):
        read_sofa(tmp_path / "gone.sofa", frequencies=TONES)
