"""What a worker copies from a store, and what it leaves there."""

import os
import stat
from pathlib import Path

import pytest

import holosonar
from holosonar import _holosonar, _remote
from holosonar._remote import Copies, Store, Units

pytest.importorskip("fsspec")

STORE = Store("job", bytes(range(32)), {})


@pytest.fixture
def copies():
    copies = Copies(STORE)
    yield copies
    copies.close()


def test_a_run_file_comes_with_its_folder_and_a_cube_alone(copies, tmp_path):
    (tmp_path / "job/meshes").mkdir(parents=True)
    for name in ("run.toml", "cube.npz", "meshes/a.obj"):
        (tmp_path / "job" / name).write_text(name)
    (tmp_path / "job/out").mkdir()
    (tmp_path / "job/out/volume.npz").write_text("large")
    job = f"{tmp_path.as_uri()}/job"
    words = copies.localised(["image", f"{job}/run.toml", "-o", f"{job}/out", "--set", "a=x://y", "--set", "x://y"])
    assert words[0] == "image" and words[4:] == ["--set", "a=x://y", "--set", "x://y"]
    folder = copies.input(f"{job}/run.toml").parent
    assert words[1] == str(folder / "run.toml") and (folder / "meshes/a.obj").read_text() == "meshes/a.obj"
    assert not (folder / "out").exists() and not words[3].startswith(str(folder))
    cube = copies.input(f"{job}/cube.npz")
    assert os.listdir(cube.parent) == ["cube.npz"]
    assert copies.restored(f"{words[1]}: no; {words[3]}: yes") == f"{job}/run.toml: no; {job}/out: yes"
    # An output's folder may be that of its input.
    beside = copies.localised(["work", f"{job}/run.toml", "-o", f"{job}/cube.zarr"])
    assert os.path.exists(beside[1]) and beside[3].endswith("cube.zarr")
    # Of one call all commands read the same.
    (tmp_path / "job/cube.npz").write_text("another")
    assert copies.input(f"{job}/cube.npz").read_text() == "cube.npz"


def test_folders_of_everything_are_refused(copies, tmp_path, monkeypatch):
    monkeypatch.setattr(_remote, "_MOST_FILES", 3)
    for name in ("run.toml", "a", "b", "c"):
        (tmp_path / name).write_text(name)
    with pytest.raises(holosonar.InputError, match="4 files.*folder of their own"):
        copies.input(f"{tmp_path.as_uri()}/run.toml")
    with pytest.raises(holosonar.InputError, match="does not exist"):
        copies.input(f"{tmp_path.as_uri()}/none/run.toml")


def test_units_are_exchanged_and_deleted_with_their_job(tmp_path):
    out = tmp_path / "out"
    (one, other) = (Copies(STORE), Copies(STORE))
    (mine, theirs) = ((copies.localised(["-o", out.as_uri()])[1]) for copies in (one, other))
    for number in range(8):
        with open(f"{mine}/.holosonar.key.{number}.unit", "w") as file:
            file.write(str(number))
    for name in (".holosonar.key.8.0.part", ".lock", "seen"):
        with open(f"{mine}/{name}", "w") as file:
            file.write(name)
    one.store()
    units = [f".holosonar.key.{number}.unit" for number in range(8)]
    assert sorted(os.listdir(out)) == [*units, "seen"]
    # Of one simulated, a sweep, four of depths and two of shards a second part of two needs the sweep and the last two depths,
    done = {"units": 8, "simulation": 1, "depths": 4, "shards": 2, "compressed": True}
    other.fetch(Units.of_part(2, 2, done))
    assert sorted(os.listdir(theirs)) == [units[1], units[4], units[5]]
    # what all need, ...
    (out / ".holosonar.other.shared.unit").write_text("reflectors")
    other.fetch(Units())
    assert os.path.exists(f"{theirs}/.holosonar.other.shared.unit")
    os.remove(f"{theirs}/.holosonar.other.shared.unit")
    # and while that is not compressed the simulation.
    other.fetch(Units.of_part(2, 2, {**done, "compressed": False}))
    assert sorted(os.listdir(theirs)) == [units[0], units[1], units[4], units[5]]
    assert stat.S_IMODE(os.stat(f"{theirs}/{units[0]}").st_mode) == 0o600
    # Shards need their depths.
    other.fetch(Units.of_shards([{"unit": 6, "depths": [3, 4]}]))
    assert sorted(os.listdir(theirs)) == [units[0], units[1], units[3], units[4], units[5], units[6]]
    other.fetch()
    assert sorted(os.listdir(theirs)) == units
    # What is damaged is replaced; what the command deletes is deleted; what it has not seen stays.
    (out / ".holosonar.key.9.unit").write_text("of others")
    with open(f"{theirs}/{units[0]}", "w") as file:
        file.write("mended")
    for name in units[1:]:
        os.remove(f"{theirs}/{name}")
    other.store()
    assert sorted(os.listdir(out)) == [units[0], ".holosonar.key.9.unit", "seen"]
    assert (out / units[0]).read_text() == "mended"
    one.close()
    other.close()
    assert not os.path.exists(mine)


def test_what_is_still_being_written_is_fetched_again(copies, tmp_path):
    folder = Path(copies.localised(["-o", tmp_path.as_uri()])[1])
    (unit, discarded) = (tmp_path / f".holosonar.key.{number}.unit" for number in range(2))
    for file in (unit, discarded):
        file.write_text("par")
    copies.fetch()
    # The command finds one damaged, and deletes its copy.
    (folder / discarded.name).unlink()
    for file in (unit, discarded):
        file.write_text("part and rest")
    copies.store()
    assert discarded.read_text() == unit.read_text() == "part and rest"
    copies.fetch()
    assert (folder / unit.name).read_text() == (folder / discarded.name).read_text() == "part and rest"
    copies.store()
    assert discarded.exists() and unit.exists()


def test_what_was_left_before_is_fetched_once(copies, tmp_path):
    (folder,) = copies.localised(["-o", tmp_path.as_uri()])[1:]
    (tmp_path / ".holosonar.key.0.unit").write_text("0")
    copies.fetch(Units(left=True))
    (tmp_path / ".holosonar.key.1.unit").write_text("1")
    copies.fetch(Units(left=True))
    assert os.listdir(folder) == [".holosonar.key.0.unit"]


def test_the_secret_is_the_users_and_private(copies, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    secret = _holosonar.users_secret()
    assert len(secret) == 32 and secret == _holosonar.users_secret()
    key = tmp_path / "state/holosonar/checkpoint.key"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600 and stat.S_IMODE(key.parent.stat().st_mode) == 0o700
    given = os.path.join(copies.environment["XDG_STATE_HOME"], "holosonar/checkpoint.key")
    with open(given, "rb") as file:
        assert file.read() == STORE.secret
    assert stat.S_IMODE(os.stat(given).st_mode) == 0o600
    assert "secret" not in repr(STORE) and "options" not in repr(STORE)
    key.write_bytes(b"short")
    with pytest.raises(holosonar.SystemFailure, match="32 bytes"):
        _holosonar.users_secret()


def test_a_store_that_takes_nothing_says_so(copies, tmp_path):
    (tmp_path / "file").write_text("")
    (folder,) = copies.localised(["-o", f"{tmp_path.as_uri()}/file"])[1:]
    with open(f"{folder}/seen", "w") as file:
        file.write("seen")
    with pytest.raises(holosonar.SystemFailure, match="file"):
        copies.store()


def test_names_that_lead_out_of_the_folder_are_refused(copies, tmp_path):
    assert _remote._below(tmp_path, "bucket/job/a/b", "bucket/job") == tmp_path / "a/b"
    assert _remote._below(tmp_path, "/a", "") == tmp_path / "a"
    for file in ("bucket/job/../../x", "bucket/job//x", "bucket/other/x", "bucket/job/a/./x", "bucket/job/"):
        with pytest.raises(holosonar.InputError, match="below bucket/job"):
            _remote._below(tmp_path, file, "bucket/job")
