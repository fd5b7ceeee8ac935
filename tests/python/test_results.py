"""Results: images, depth maps, plans, pictures, xarray."""

import xml.dom.minidom

import numpy as np
import pytest

import holosonar

pytestmark = pytest.mark.filterwarnings("ignore::holosonar.HolosonarWarning")
PNG = b"\x89PNG\r\n"


@pytest.fixture(scope="module")
def image(corner):
    return holosonar.image(corner)


def test_an_image_has_everything(image):
    assert image.volume.samples.shape == image.volume.grid.shape
    assert image.depth.depth.shape == image.truth.depth.shape == image.volume.grid.shape[1:]
    assert image.scores["completeness"] > 0.5
    assert image.scores == holosonar.compare(image.depth, image.truth)
    assert image.report["accepted"] == image.depth.accepted == np.isfinite(image.depth.depth).sum()
    depth = image.depth
    found = np.isfinite(depth.depth)
    assert np.allclose(np.linalg.norm(depth.normals[found], axis=-1), 1, atol=1e-4)
    assert (depth.normals[found][:, 2] < 0).all(), "they face the array"
    assert np.allclose(depth.range[found], np.linalg.norm(depth.points[found], axis=-1))
    assert depth.error.shape == depth.confidence.shape == depth.depth.shape
    assert image.truth.confidence is None and image.truth.materials == ["wall"]
    assert (image.truth.picked.material > 0).any() and np.nanmax(image.truth.picked.facing) <= 1


def test_depth_of_a_volume_made_by_hand():
    z = 1.0 + 0.01 * np.arange(41)
    column = np.exp(-0.5 * ((z - 1.204) / 0.01) ** 2).astype(np.complex64)
    axis = holosonar.Axis(0.0, 0.01, 1)
    grid = holosonar.Grid(axis, axis, holosonar.Axis(1.0, 0.01, 41))
    volume = holosonar.Volume(column[:, None, None], grid)
    with pytest.raises(holosonar.InputError, match="bandwidth"):
        holosonar.locate_depth(volume)
    run = holosonar.RunFile(set={"sweep.start": 10e3, "sweep.stop": 20e3})
    depth = holosonar.locate_depth(volume, run=run)
    assert depth.depth[0, 0] == pytest.approx(1.204, abs=5e-4)
    column = holosonar.locate_depth(volume, run=run, refine="column", set={"depth.median": 1})
    assert column.depth[0, 0] == pytest.approx(1.204, abs=5e-4) and column.normals is None


def test_depth_maps_are_written_and_read(tmp_path, image):
    image.depth.write(tmp_path / "depth.exr")
    again = holosonar.read_depth(tmp_path / "depth.exr")
    assert np.array_equal(again.depth, image.depth.depth, equal_nan=True)
    assert again.meta["range_resolution"] == image.depth.meta["range_resolution"]
    assert again.meta["run"] == image.depth.meta["run"]
    image.depth.write(tmp_path / "depth.ply")
    assert (tmp_path / "depth.ply").read_bytes().startswith(b"ply")
    image.depth.write(tmp_path / "nan.exr", set={"depth.fill": "nan"})
    assert (tmp_path / "nan.exr").read_bytes() != (tmp_path / "depth.exr").read_bytes()


def test_a_depth_map_of_ones_own(image):
    """Infinities, as other programs write them, are no surface."""
    depth = np.full((2, 3), np.inf, np.float32)
    depth[0, 1] = 1.5
    own = holosonar.DepthMap(holosonar.DepthLayer(depth), holosonar.Axis(0, 0.1, 3), holosonar.Axis(0, 0.1, 2))
    assert own.accepted == 1 and own.amplitude.sum() == 1
    with pytest.raises(holosonar.InputError, match="resolution"):
        holosonar.compare(own, own)
    assert holosonar.compare(own, own, resolution=0.01)["completeness"] == 1
    with pytest.raises(holosonar.InputError, match="2, 3.*41, 41"):
        holosonar.compare(own, image.truth)
    with pytest.raises(holosonar.InputError, match="axes"):
        holosonar.DepthMap(holosonar.DepthLayer(depth), holosonar.Axis(0, 0.1, 2), holosonar.Axis(0, 0.1, 2))


def test_pictures_for_notebooks(image, tmp_path):
    for shown in (image.volume, image.depth, image.truth):
        assert shown.picture().startswith(PNG)
        xml.dom.minidom.parseString(shown._repr_html_().replace('">', '"/>', 1))
    assert image._repr_html_().count("data:image/png;base64,") == 3
    assert "completeness" in image._repr_html_() and "completeness" in repr(image)
    assert holosonar.error_picture(image.depth, image.truth).startswith(PNG)


def test_xarray_has_coordinates_and_units(image, corner, scattered, reflectors):
    pytest.importorskip("xarray")
    volume = image.volume.to_xarray()
    assert volume.dims == ("z", "y", "x") and volume.z.attrs["units"] == "m"
    assert np.shares_memory(volume.values, image.volume.samples)
    assert volume.z.values[-1] == pytest.approx(image.volume.grid.z.last)
    assert float(abs(volume).max()) == pytest.approx(image.volume.amplitude.max())
    maps = image.depth.to_xarray()
    assert maps.depth.attrs["units"] == "m" and set(maps.depth.dims) == {"y", "x"}
    assert {"amplitude", "confidence", "error", "range", "normals", "return1"} <= set(maps)
    cube = holosonar.simulate(corner).to_xarray()
    assert cube.dims == ("frequency", "y", "x") and cube.frequency.attrs["units"] == "Hz"
    array = holosonar.simulate(reflectors, scattered).to_xarray()
    assert array.dims == ("frequency", "microphone") and array.sel(microphone=3).x == scattered.mic_positions[3, 0]


def test_plans_sweeps_and_points(corner):
    plan = holosonar.plan(corner)
    assert plan.range_resolution == plan["plan"]["range_resolution"] > 0
    assert plan.peak_memory > 1e6 and plan.seconds > 0 and "unambiguous" in str(plan)
    assert plan._repr_html_().startswith("<pre>") and dict(plan)["files"]
    rows = holosonar.plan_sweep(corner, {"sweep.stop": [15e3, 20e3], "array.extent": [[0.5, 0.5], [1.0, 1.0], "x"]})
    assert [row["sweep.stop"] for row in rows] == [15e3] * 3 + [20e3] * 3
    assert rows[0]["range_resolution"] == pytest.approx(343 / 10e3)
    assert rows[0]["widths"][1] > rows[1]["widths"][1] and rows[2]["refused"] and not rows[0]["refused"]
    spreads = holosonar.psf(corner, [(0.0, 0.0, 1.5)])
    assert len(spreads) == 1 and spreads[0]["amplitude"] == pytest.approx(1, abs=0.01)
    assert spreads.picture().startswith(PNG)


def test_sweeps_are_simulated_and_resumed(corner, tmp_path, command):
    keys = {"array.count": [7, 11], "sweep.step": [200, 300]}
    small = ["sweep.stop=14000", "grid.pitch=[0.1,0.1,0.02]"]
    rows = holosonar.plan_sweep(corner, keys, set=small, simulate=True, seeds=[1, 2], output=tmp_path / "sweep")
    assert [row["sweep.step"] for row in rows] == [200, 300] * 2
    valid = [row for row in rows if not row["refused"]]
    assert [row["sweep.step"] for row in valid] == [200, 200] and "300" in rows[1]["refused"]
    for row in valid:
        own = [*small, f"array.count={row['array.count']}", "sweep.step=200"]
        scores = [holosonar.image(corner, set=[*own, f"reflectors.seed={seed}"]).scores for seed in (1, 2)]
        assert row["completeness"] == pytest.approx(sum(s["completeness"] for s in scores) / 2)
        assert row["error"] == row["chamfer_distance"] and row["seeds"] == [1, 2] and row["expected"] is False
        assert row["acquisition_seconds"] == pytest.approx(21 * row["tone_seconds"])
        assert "peak_bytes" not in row and row["completeness_sd"] >= 0
    assert any(row["front"] for row in valid)
    table = (tmp_path / "sweep/sweep.csv").read_bytes()
    # The command finds all that is finished there, and writes the same table.
    swept = [word for key, values in keys.items() for word in ("--sweep", f"{key}={','.join(map(str, values))}")]
    settings = [word for setting in small for word in ("--set", setting)]
    ran = command("plan", corner, *swept, *settings, "--simulate", "--seeds", "1,2", "-o", tmp_path / "sweep")
    assert "to be simulated" not in ran.stderr
    assert (tmp_path / "sweep/sweep.csv").read_bytes() == table
    with pytest.raises(holosonar.InputError, match="simulate"):
        holosonar.plan_sweep(corner, keys, seeds=[1])
    with pytest.raises(holosonar.InputError, match="median_error"):
        holosonar.plan_sweep(corner, keys, simulate=True, measure="median")


def test_run_files(corner, tmp_path):
    run = holosonar.RunFile(corner, set=["sweep.step=40"])
    assert run["sweep.step"] == 40 and run.with_settings({"sweep.step": 80})["sweep.step"] == 80
    assert run["sweep.step"] == 40 and run != run.with_settings({"sweep.step": 80})
    again = holosonar.RunFile.from_toml(run.to_toml(), folder=corner.parent)
    assert again == run and again.path is None and run.path == corner
    with pytest.raises(KeyError):
        run["sweep.steps"]
    settings = {
        "scene.mesh": tmp_path / "a b.obj",
        "grid.x": (np.float32(-0.5), np.int64(1)),
        "depth.gate": np.bool_(False),
        "output.formats": ["npz", "vti"],
        "depth.rim_db": np.float32(-3.5),
    }
    set_all = holosonar.RunFile(set=settings)
    assert set_all["scene.mesh"] == str(tmp_path / "a b.obj") and set_all["grid.x"] == [-0.5, 1.0]
    assert set_all["depth.gate"] is False and set_all["output.formats"] == ["npz", "vti"]
    with pytest.raises(holosonar.InputError, match="depth.rim_db=-inf.*finite"):
        holosonar.RunFile(set={"depth.rim_db": -np.inf})
    with pytest.raises(TypeError, match="setting"):
        holosonar.RunFile(set={"sweep.step": object()})


def test_a_bare_mesh_is_placed(corner):
    mesh = corner.parents[3] / "scenes/meshes/bracket.obj"
    run = holosonar.RunFile(mesh, set={"scene.unit": "mm", "scene.up": "z"})
    assert run.has_scene and run["scene.fit"][2] > 0.2
    plan = holosonar.plan(run)
    assert plan["plan"]["microphones"] == 101 * 101


def test_threads_change_no_byte(corner, tmp_path):
    import os
    import subprocess
    import sys

    program = "import holosonar, sys; holosonar.reconstruct(holosonar.simulate(sys.argv[1]), run=sys.argv[1]).write(sys.argv[2])"
    written = []
    for threads in "1", "3":
        path = tmp_path / f"{threads}.npz"
        environment = {**os.environ, "RAYON_NUM_THREADS": threads}
        subprocess.run([sys.executable, "-c", program, corner, path], env=environment, check=True)
        written.append(path.read_bytes())
    assert written[0] == written[1]
