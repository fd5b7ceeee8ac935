"""A cluster's image has the bytes of one process, also when a worker is killed; a job can be cancelled, and says what fails."""

import json
import os
import shutil
import signal
import threading
import time

import pytest

import holosonar

distributed = pytest.importorskip("distributed")

from holosonar.distributed import check, image, plan_sweep, reconstruct, simulate  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")

RUN = """
[scene]
mesh = "{mesh}"
unit = "m"
up = "none"
[sweep]
start = 10e3
stop = 20e3
step = 25.0
[array]
count = [48, 48]
pitch = [0.02, 0.02]
[grid]
x = [-0.5, 0.5]
y = [-0.5, 0.5]
z = [1.4, 2.2]
pitch = [0.02, 0.02, 0.01]
[output]
formats = ["npz"]
report = false
points = false
"""


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        with distributed.Client(cluster, set_as_default=False) as client:
            yield cluster, client


@pytest.fixture
def scene(tmp_path, corner):
    mesh = corner.parents[3] / "scenes/meshes/corner.obj"
    (tmp_path / "run.toml").write_text(RUN.format(mesh=mesh))
    return tmp_path / "run.toml"


def same(a, b):
    return (a / "volume.npz").read_bytes() == (b / "volume.npz").read_bytes()


def contents(store):
    return {path.relative_to(store): path.read_bytes() for path in store.rglob("*") if path.is_file()}


def test_the_bytes_are_those_of_one_process(cluster, scene, tmp_path, command):
    _, client = cluster
    command("image", scene, "-o", tmp_path / "one")
    told = []
    report = image(scene, tmp_path / "many", client, parts=5, progress=lambda done, units: told.append((done, units)))
    assert same(tmp_path / "one", tmp_path / "many")
    assert report["accepted"] > 0 and told[-1][0] == told[-1][1]
    assert not [name for name in os.listdir(tmp_path / "many") if name.endswith((".unit", ".part"))]


def test_a_worker_that_is_killed_is_replaced(cluster, scene, tmp_path, command):
    _, client = cluster
    command("image", scene, "-o", tmp_path / "one")
    pids = list(client.run(os.getpid).values())

    def kill():
        # In the midst of its task.
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline and not any(
            name.endswith((".unit", ".part")) for name in os.listdir(tmp_path / "many") if (tmp_path / "many").exists()
        ):
            time.sleep(0.01)
        os.kill(pids[0], signal.SIGKILL)

    (tmp_path / "many").mkdir()
    killer = threading.Thread(target=kill)
    killer.start()
    image(scene, tmp_path / "many", client, parts=6)
    killer.join()
    assert pids[0] not in client.run(os.getpid).values()
    assert same(tmp_path / "one", tmp_path / "many")


def test_a_sweep_has_the_bytes_of_one_process(cluster, scene, tmp_path, command):
    _, client = cluster
    keys = {"array.count": ["15", "[11,15]"], "sweep.step": "100:200:100"}
    small = ["grid.pitch=[0.05,0.05,0.02]", "sweep.stop=14000", "array.extent=0.5"]
    words = ["--sweep", "array.count=15,[11,15]", "--sweep", "sweep.step=100:200:100"]
    words += [word for setting in small for word in ("--set", setting)]
    command("plan", scene, *words, "--simulate", "--seeds", "1,2", "-o", tmp_path / "one")
    told = []
    sweep = plan_sweep(
        scene, keys, tmp_path / "many", client, seeds=[1, 2], settings=small, progress=lambda *done: told.append(done)
    )
    for name in ("sweep.csv", "sweep.json", "sweep.png", "pareto.png"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()
    assert len(sweep["combinations"]) == 4 and told[-1] == (4, 4)
    assert all(row["simulated"]["mean"]["completeness"] > 0 for row in sweep["combinations"])
    with pytest.raises(holosonar.InputError, match="median_error"):
        plan_sweep(scene, keys, tmp_path / "many", client, measure="median")
    with pytest.raises(holosonar.InputError, match="parts"):
        plan_sweep(scene, keys, tmp_path / "many", client, parts=0)


def test_a_job_that_is_refused_says_why(cluster, scene, tmp_path):
    _, client = cluster
    with pytest.raises(holosonar.InputError, match="pitch"):
        image(scene, tmp_path / "many", client, settings=["grid.pitch=0"])
    with pytest.raises(holosonar.InputError, match="parts"):
        image(scene, tmp_path / "many", client, parts=0)


def test_cancelling_ends_the_commands_of_the_workers(cluster, scene, tmp_path):
    _, client = cluster

    def stop(done, units):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        image(scene, tmp_path / "many", client, parts=9, progress=stop)
    # What was stored is used.
    assert image(scene, tmp_path / "many", client, parts=2)["accepted"] > 0


def test_a_cube_and_its_volume_have_the_bytes_of_one_process(cluster, scene, tmp_path, command):
    _, client = cluster
    coarse = ["sweep.step=50", "detection.snr_db=20"]
    command("simulate", scene, "-o", tmp_path / "one.npz", *(word for one in coarse for word in ("--set", one)))
    told = []
    cube = simulate(
        scene, tmp_path / "new" / "cube.npz", client, settings=coarse, parts=7, progress=lambda *done: told.append(done)
    )
    assert cube == tmp_path / "new" / "cube.npz" and cube.read_bytes() == (tmp_path / "one.npz").read_bytes()
    assert told[-1][0] == told[-1][1] > 0
    assert holosonar.read_cube(cube).shape == (201, 48, 48)
    command("reconstruct", cube, "-c", scene, "-o", tmp_path / "one.npz", "-o", tmp_path / "one.vti")
    volumes = reconstruct(cube, [tmp_path / "many.npz", tmp_path / "many.vti"], client, config=scene, parts=7)
    assert volumes == [tmp_path / "many.npz", tmp_path / "many.vti"]
    for volume in volumes:
        assert volume.read_bytes() == volume.with_stem("one").read_bytes()
    # A store takes units more, whose shards several tasks have the depths of.
    (told, more) = ([], [])
    reconstruct(cube, volumes, client, config=scene, parts=7, progress=lambda *done: told.append(done))
    stores = [tmp_path / "one.zarr", tmp_path / "many.zarr"]
    command("reconstruct", cube, "-c", scene, "-o", stores[0])
    reconstruct(cube, stores[1], client, config=scene, parts=7, progress=lambda *done: more.append(done))
    assert more[-1][0] == more[-1][1] > told[-1][1]
    assert contents(stores[0]) == contents(stores[1])
    assert not [name for name in os.listdir(tmp_path) if name.endswith((".unit", ".part"))]
    with pytest.raises(holosonar.InputError, match="refine"):
        reconstruct(cube, tmp_path / "many.npz", client, config=scene, settings=["refine.method=fista"])
    with pytest.raises(holosonar.InputError, match="cube"):
        reconstruct(scene, tmp_path / "many.npz", client)
    with pytest.raises(holosonar.InputError, match="output is empty"):
        reconstruct(cube, [], client)
    with pytest.raises(holosonar.InputError, match="many.vti"):
        simulate(scene, tmp_path / "many.vti", client)


def test_scenes_are_checked_as_the_command_checks_them(cluster, corner, tmp_path, command):
    _, client = cluster
    (small, limits) = corner.read_text().replace("../../../", f"{corner.parents[3]}/").split("[expect]")
    (tmp_path / "kept.toml").write_text(f"{small}[expect]{limits.replace('[1, 2, 3]', '[3, 1, 2]')}")
    (tmp_path / "missed.toml").write_text(f"{small}[expect]\ncompleteness = {{ min = 1.0 }}\n")
    (tmp_path / "none.toml").write_text(small)
    runs = [tmp_path / name for name in ("kept.toml", "missed.toml", "none.toml", "gone.toml")]
    told = []
    rows = check(runs, client, progress=lambda *done: told.append(done))
    assert rows == json.loads(command("check", *runs, "--json", status=2).stdout)
    assert told[-1] == (6, 6)
    assert rows[0]["seeds"] == [3, 1, 2] and all(limit["kept"] for limit in rows[0]["limits"])
    assert not rows[1]["limits"][0]["kept"] and "[expect]" in rows[2]["error"] and "gone.toml" in rows[3]["error"]
    rows = check(runs[0], client, seeds=[5, 7], oracle=True, settings=["sweep.step=50"])
    words = ["--seeds", "5,7", "--oracle", "--set", "sweep.step=50"]
    assert rows == json.loads(command("check", runs[0], "--json", *words).stdout)
    assert rows[0]["seeds"] == [5, 7] and rows[0]["oracle"]["metrics"]["completeness"] > 0
    with pytest.raises(holosonar.InputError, match="runs is empty"):
        check([], client)


@pytest.fixture
def stored(tmp_path, corner):
    """The scene in a folder with all that it names, and the URL of a store."""
    meshes = tmp_path / "job" / "meshes"
    meshes.mkdir(parents=True)
    shutil.copy(corner.parents[3] / "scenes/meshes/corner.obj", meshes)
    (tmp_path / "job/run.toml").write_text(RUN.format(mesh="meshes/corner.obj"))
    return tmp_path.as_uri()


def test_workers_that_share_no_folder_work_by_a_store(cluster, stored, tmp_path, command):
    _, client = cluster
    run = tmp_path / "job/run.toml"
    command("image", run, "-o", tmp_path / "one")
    told = []
    report = image(
        f"{stored}/job/run.toml",
        f"{stored}/many",
        client,
        parts=5,
        storage_options={"auto_mkdir": True},
        progress=lambda *done: told.append(done),
    )
    assert same(tmp_path / "one", tmp_path / "many") and report["accepted"] > 0
    assert told == sorted(told) and told[-1][0] == told[-1][1]
    assert sorted(os.listdir(tmp_path / "many")) == sorted(os.listdir(tmp_path / "one"))
    coarse = ["sweep.step=50", "detection.snr_db=20"]
    words = [word for one in coarse for word in ("--set", one)]
    command("simulate", run, "-o", tmp_path / "one.npz", *words)
    cube = simulate(f"{stored}/job/run.toml", f"{stored}/new/cube.npz", client, settings=coarse, parts=7)
    assert cube == f"{stored}/new/cube.npz"
    assert (tmp_path / "new/cube.npz").read_bytes() == (tmp_path / "one.npz").read_bytes()
    command("reconstruct", tmp_path / "one.npz", "-c", run, "-o", tmp_path / "one.vti", "-o", tmp_path / "one.zarr")
    outputs = [f"{stored}/new/many.zarr", f"{stored}/new/many.vti"]
    assert reconstruct(cube, outputs, client, config=f"{stored}/job/run.toml") == outputs
    assert (tmp_path / "new/many.vti").read_bytes() == (tmp_path / "one.vti").read_bytes()
    (one, many) = (contents(tmp_path / "one.zarr"), contents(tmp_path / "new/many.zarr"))
    assert one == many and len(one) > 3
    assert sorted(os.listdir(tmp_path / "new")) == ["cube.npz", "many.vti", "many.zarr"]
    # Nothing is left on workers.
    assert set(client.run(lambda: len(holosonar._remote._COPIES)).values()) == {0}


def test_what_a_store_holds_of_a_cancelled_job_is_used(cluster, stored, tmp_path):
    _, client = cluster

    def stop(done, units):
        raise KeyboardInterrupt

    (run, output) = (f"{stored}/job/run.toml", f"{stored}/many")
    with pytest.raises(KeyboardInterrupt):
        image(run, output, client, parts=9, progress=stop)
    units = [name for name in os.listdir(tmp_path / "many") if name.endswith(".unit")]
    assert units
    # What was cut off is computed again.
    (tmp_path / "many" / units[0]).write_bytes((tmp_path / "many" / units[0]).read_bytes()[:100])
    told = []
    assert image(run, output, client, parts=2, progress=lambda *done: told.append(done))["accepted"] > 0
    assert not [name for name in os.listdir(tmp_path / "many") if name.startswith(".")]


def test_sweeps_and_checks_by_a_store(cluster, stored, tmp_path, command):
    _, client = cluster
    small = ["grid.pitch=[0.05,0.05,0.02]", "sweep.stop=14000", "array.extent=0.5"]
    run = tmp_path / "job/run.toml"
    words = [word for setting in small for word in ("--set", setting)]
    command("plan", run, "--sweep", "array.count=11,15", *words, "--simulate", "-o", tmp_path / "one")
    sweep = plan_sweep(f"{stored}/job/run.toml", {"array.count": [11, 15]}, f"{stored}/many", client, settings=small)
    for name in ("sweep.csv", "sweep.json", "sweep.png", "pareto.png"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()
    assert len(sweep["combinations"]) == 2 and len(list((tmp_path / "many/combinations").iterdir())) == 2
    expect = ["expect.completeness.min=0.1", "expect.seeds=[3,4]"]
    (row,) = check(f"{stored}/job/run.toml", client, settings=[*small, *expect])
    assert row["scene"] == f"{stored}/job/run.toml" and row["seeds"] == [3, 4] and row["limits"][0]["kept"]


def test_what_a_store_lacks_is_refused(cluster, stored, tmp_path):
    _, client = cluster
    with pytest.raises(holosonar.InputError, match="job/other.toml does not exist"):
        image(f"{stored}/job/other.toml", f"{stored}/many", client)
    with pytest.raises(holosonar.InputError, match="nosuch"):
        image("nosuch://job/run.toml", f"{stored}/many", client)
    # Places are those of the store.
    with pytest.raises(holosonar.InputError, match=f"^{stored}/job/run.toml.* {stored}/job/meshes/none.obj"):
        image(f"{stored}/job/run.toml", f"{stored}/many", client, settings=["scene.mesh=meshes/none.obj"])
