"""HDF5 files in which one variable is something else: read or refused, never another exception."""

import numpy as np
import pytest
import test_io_acoular
import test_io_matlab
import test_io_sofa
import test_io_uff
from field_formats import MICROPHONES, TONES, measured, responses_of

import holosonar
from holosonar.io import read_acoular, read_matlab, read_sofa, read_uff

h5py = pytest.importorskip("h5py")
pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning", "ignore::RuntimeWarning")

#: What a variable becomes; `None` for a group.
OTHERS = {
    "gone": "gone",
    "a group": None,
    "bytes": np.bytes_("abc"),
    "text": "abc",
    "empty": np.zeros((0, 3)),
    "one number": 1.5,
    "not finite": np.nan,
    "several that are not finite": np.full(3, np.nan),
    "zero": 0.0,
    "complex": np.ones((2, 3), complex),
    "of five axes": np.ones((1, 2, 3, 1, 1)),
}


def uff(folder):
    signals = np.stack([test_io_uff.heard((0, 0, 0), 0.0, 0.0).T] * 2, axis=-1)
    test_io_uff.write(folder / "a.uff", signals, [test_io_uff.wave((0, 0, 0)), test_io_uff.wave((0, 0, -0.1))], 0.0)
    return folder / "a.uff", lambda path: read_uff(path, frequencies=TONES, wave=0)


def sofa(folder):
    places, source = test_io_sofa.in_sofa(test_io_sofa.PLACES), test_io_sofa.in_sofa(test_io_sofa.SOURCE)[None]
    path = folder / "a.sofa"
    test_io_sofa.write(path, test_io_sofa.of_responses(responses_of(measured())[None], places, source))
    return path, lambda path: read_sofa(path, frequencies=TONES)


def matlab(folder):
    path, samples = folder / "a.mat", measured().samples.astype(complex)
    test_io_matlab.save_new(path, {"s": {"m": samples}, "f": TONES, "r": MICROPHONES})
    return path, lambda path: read_matlab(path, phase_sign=1)


def acoular(folder):
    path, array = test_io_acoular.recording(folder, np.ones((300, 20))), test_io_acoular.geometry(folder)
    return path, lambda path: read_acoular(path, array, frequencies=TONES, signal="responses")


@pytest.mark.parametrize("write", [uff, sofa, matlab, acoular])
def test_files_with_something_else_in_them(tmp_path, write):
    path, read = write(tmp_path)
    whole, names, refused, tried = path.read_bytes(), [], 0, 0
    read(path)
    with h5py.File(path, "r") as file:
        file.visit(names.append)
    for name in names:
        for other in OTHERS.values():
            path.write_bytes(whole)
            with h5py.File(path, "r+") as file:
                del file[name]
                if other is None:
                    file.create_group(name)
                elif not (isinstance(other, str) and other == "gone"):
                    file[name] = other
            tried += 1
            try:
                assert isinstance(read(path), holosonar.Cube)
            except holosonar.HolosonarError as wrong:
                assert str(wrong)
                refused += 1
    assert refused >= tried / 3, f"{refused} of {tried}"


def test_sizes_that_no_machine_holds(tmp_path):
    path, read = acoular(tmp_path)
    with h5py.File(path, "r+") as file:
        del file["time_data"]
        held = file.create_dataset("time_data", (10**12, 20), np.float32, chunks=(1000, 20))  # nothing of it is written
        held.attrs["sample_freq"] = 48e3
    with pytest.raises(holosonar.OutOfMemoryError, match=r"recording\.h5: `time_data` takes 149011\.6 GiB, and this machine"):
        read(path)
    path, read = uff(tmp_path)
    with h5py.File(path, "r+") as file:
        del file["channel_data/data"]
        file.create_dataset("channel_data/data", (2, 63, 10**12), np.float32, chunks=(1, 63, 1000))
    with pytest.raises(holosonar.OutOfMemoryError, match=r"a\.uff: `channel_data/data` takes"):
        read(path)
    path, read = matlab(tmp_path)
    with h5py.File(path, "r+") as file:
        file.create_dataset("huge", (10**6, 10**8), np.float64, chunks=(1000, 1000))
    with pytest.raises(holosonar.OutOfMemoryError, match=r"a\.mat: `huge` takes"):
        read(path)
