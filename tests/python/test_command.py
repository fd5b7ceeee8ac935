"""The same bytes as the command line, file by file; and the command that the package brings."""

import json

import numpy as np
import pytest

import holosonar

pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")


def test_a_cube_and_its_volume_are_those_of_the_command_line(tmp_path, corner, command):
    theirs, ours = tmp_path / "theirs", tmp_path / "ours"
    ours.mkdir()
    command("simulate", corner, "-o", theirs / "cube.npz", "-q")
    volumes = [theirs / f"volume.{ending}" for ending in ("npz", "exr", "vti", "nrrd", "vdb")]
    outputs = [word for volume in volumes for word in ("-o", volume)]
    command("reconstruct", theirs / "cube.npz", "-c", corner, *outputs, "-q")
    command("depth", theirs / "volume.npz", "-c", corner, "-o", theirs / "depth.exr", "-q")
    command("truth", corner, "-o", theirs / "truth.exr", "-q")

    cube = holosonar.simulate(corner)
    cube.write(ours / "cube.npz")
    volume = holosonar.reconstruct(cube, run=corner)
    for path in volumes:
        assert volume.write(ours / path.name, run=corner) == [str(ours / path.name)]
    depth = holosonar.locate_depth(volume, run=corner)
    depth.write(ours / "depth.exr", run=corner)
    truth = holosonar.truth(corner)
    truth.write(ours / "truth.exr", run=corner)
    names = sorted(path.name for path in theirs.iterdir())
    assert names == sorted(path.name for path in ours.iterdir())
    for name in names:
        assert (theirs / name).read_bytes() == (ours / name).read_bytes(), name

    # What was read is written again as it was.
    holosonar.read_cube(theirs / "cube.npz").write(ours / "again.npz")
    assert (ours / "again.npz").read_bytes() == (theirs / "cube.npz").read_bytes()
    holosonar.read_volume(theirs / "volume.npz").write(ours / "again2.npz")
    assert (ours / "again2.npz").read_bytes() == (theirs / "volume.npz").read_bytes()
    assert np.array_equal(np.load(theirs / "volume.npz")["samples"], volume.samples)

    printed = json.loads(command("compare", theirs / "depth.exr", theirs / "truth.exr", "--json").stdout)
    for pair in ((depth, truth), (theirs / "depth.exr", theirs / "truth.exr")):
        assert holosonar.compare(*pair).metrics == pytest.approx(printed["metrics"])


def test_stores_are_those_of_the_command_line(tmp_path, corner, command):
    theirs, ours = tmp_path / "theirs", tmp_path / "ours"
    setting = {"output.components": "complex"}
    command("simulate", corner, "-o", theirs / "cube.zarr", "-q")
    command("reconstruct", theirs / "cube.zarr", "-c", corner, "-o", theirs / "volume.zarr", "-q",
            "--set", "output.components=complex")  # fmt: skip
    cube = holosonar.simulate(corner)
    cube.write(ours / "cube.zarr")
    volume = holosonar.reconstruct(theirs / "cube.zarr", run=corner, set=setting)
    volume.write(ours / "volume.zarr", run=corner, set=setting)
    names = sorted(path.relative_to(theirs) for path in theirs.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(ours) for path in ours.rglob("*") if path.is_file())
    for name in names:
        assert (theirs / name).read_bytes() == (ours / name).read_bytes(), name
    assert np.array_equal(holosonar.read_cube(ours / "cube.zarr").samples, cube.samples)
    assert np.array_equal(holosonar.read_volume(ours / "volume.zarr").samples, volume.samples)
    with pytest.raises(holosonar.InputError, match=r"cube\.txt.*\.zarr"):
        cube.write(ours / "cube.txt")


@pytest.mark.parametrize("setting", [{}, {"detection.kind": "in-phase", "reconstruct.window": "hann"}])
def test_image_writes_the_files_of_the_command_line(tmp_path, corner, command, setting):
    typed = [word for key, value in setting.items() for word in ("--set", f"{key}={value}")]
    command("image", corner, "-o", tmp_path / "theirs", *typed, "-q")
    image = holosonar.image(corner, output=tmp_path / "ours", set=setting)
    names = sorted(path.name for path in (tmp_path / "theirs").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "ours").iterdir())
    assert names == sorted(path.name for path in image.files)
    for name in set(names) - {"report.json", "report.html"}:  # they have timings
        assert (tmp_path / "theirs" / name).read_bytes() == (tmp_path / "ours" / name).read_bytes(), name
    reports = [json.loads((tmp_path / side / "report.json").read_text()) for side in ("theirs", "ours")]
    for report in (*reports, image.report):
        report.pop("timings")
    assert reports[0] == reports[1] == image.report

    # In memory it is the same.
    again = holosonar.image(holosonar.RunFile(corner, set=setting))
    assert np.array_equal(again.volume.samples, image.volume.samples)
    assert np.array_equal(again.depth.depth, image.depth.depth, equal_nan=True)
    assert again.scores == image.scores and again.files == []


def test_a_cube_is_imaged_as_its_file_is(tmp_path, corner, command):
    cube = holosonar.simulate(corner)
    cube.write(tmp_path / "cube.npz")
    command("image", tmp_path / "cube.npz", "-c", corner, "-o", tmp_path / "theirs", "-q")
    for name, scene in (("memory", cube), ("file", tmp_path / "cube.npz")):
        image = holosonar.image(scene, run=corner, output=tmp_path / name)
        assert image.truth is None and image.scores is None
        for written in ("volume.npz", "depth.exr", "depth.png", "amplitude.png"):
            if (tmp_path / "theirs" / written).exists():
                assert (tmp_path / name / written).read_bytes() == (tmp_path / "theirs" / written).read_bytes()
        assert (tmp_path / name / "depth.exr").exists()


def test_the_command_has_the_exit_status_and_the_help(command, tmp_path):
    assert "Exit status" in command("--help").stdout
    assert command("--version").stdout.startswith(f"holosonar {holosonar.__version__}")
    assert "no such file" in command("image", tmp_path / "gone.toml", "-o", tmp_path / "out", status=2).stderr
    assert "unexpected argument" in command("image", "--wrong", status=2).stderr
