#!/usr/bin/env python3
"""Holds a perspective truth to Blender's own Z pass, opens depth maps in Blender's compositor, and reads OpenVDB volumes.

    check_blender.py MESH.gltf CAMERA OUTDIR
    check_blender.py --volume OUTDIR...      compares volume.vdb with volume.npz
    check_blender.py --prove OUTDIR          damages copies of volume.vdb and sees that it is noticed

In the first form OUTDIR is a result of `holosonar image` whose array sits at the camera of this name, in its perspective view. Blender (the
module bpy from PyPI) imports the file and renders it from that camera with Cycles, one sample through each pixel's centre.
Its depth must be that of truth.exr, to 0.1 mm at 99.5 % of the pixels; pixels beside a jump in depth are left out, since
there a hair's breadth decides between two surfaces. The render is left as OUTDIR/blender.exr.

A volume.vdb is read by the OpenVDB that Blender contains, voxel by voxel, and imported as a volume object, of which Blender
makes a mesh. Exit status 1 if a check fails.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
import OpenEXR

# Blender keeps its Python modules beside itself.
sys.path += map(str, Path(bpy.utils.resource_path("LOCAL")).glob("python/lib/python*/site-packages"))
try:
    import openvdb
except ModuleNotFoundError:  # until Blender 4.4
    import pyopenvdb as openvdb

LIMIT, SHARE, JUMP = 1e-4, 0.995, 0.02  # m, of the pixels, m
failed = []


def check(what, holds, detail=""):
    print(f"{'ok' if holds else 'FAILED'}: {what} {detail}".rstrip(), flush=True)
    if not holds:
        failed.append(what)


def channel(path, end):
    """The channel of that name in any part, or the one whose name ends so."""
    parts = OpenEXR.File(str(path), separate_channels=True).parts
    channels = {name: channel for part in parts for name, channel in part.channels.items()}
    name = end if end in channels else next(name for name in channels if name.endswith("." + end))
    return channels[name].pixels.astype(np.float64)


def render(mesh, camera, shape, out):
    """The depth that Cycles sees, m; infinite where there is nothing."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for addon in ("cycles", "io_scene_gltf2"):
        bpy.ops.preferences.addon_enable(module=addon)
    bpy.ops.import_scene.gltf(filepath=str(mesh))
    scene = bpy.context.scene
    scene.camera = next(o for o in bpy.data.objects if o.type == "CAMERA" and camera in (o.name, o.data.name))
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 1
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.filter_width = 0.01
    scene.render.filter_size = 0.01
    scene.render.resolution_y, scene.render.resolution_x = shape
    scene.render.resolution_percentage = 100
    bpy.context.view_layer.use_pass_z = True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # since Blender 5.0
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    scene.render.filepath = str(out)
    bpy.ops.render.render(write_still=True)
    depth = channel(out, "Depth.Z")
    return np.where(depth < 1e9, depth, np.inf)


def beside_a_jump(depth):
    """Pixels of which a neighbour's depth is another surface's, or no surface's."""
    padded = np.pad(depth, 1, mode="edge")
    rows, columns = depth.shape
    near = [padded[r : r + rows, c : c + columns] for r in range(3) for c in range(3)]
    return np.max(near, axis=0) - np.min(near, axis=0) > JUMP


def compare(ours, theirs):
    finite = np.isfinite(ours) | np.isfinite(theirs)
    ours, theirs = np.where(np.isfinite(ours), ours, 1e9), np.where(np.isfinite(theirs), theirs, 1e9)
    scored = finite & ~beside_a_jump(ours) & ~beside_a_jump(theirs)
    off = np.abs(ours - theirs)
    share = (off[scored] <= LIMIT).mean()
    everywhere = (off[finite] <= LIMIT).mean()
    check(
        "truth.exr is Blender's Z pass",
        scored.mean() > 0.5 and share >= SHARE,
        f"({100 * share:.3f} % of {scored.sum()} pixels within 0.1 mm; with silhouettes {100 * everywhere:.2f} % of "
        f"{finite.sum()}; greatest beside none {off[scored].max():.1e} m)",
    )


def in_compositor(path):
    """A file as the compositor's Image node shows it: the passes, and the numbers of one."""
    image = bpy.data.images.load(str(path))
    size = tuple(image.size)
    tree = bpy.data.node_groups.new("passes", "CompositorNodeTree")
    node = tree.nodes.new("CompositorNodeImage")
    node.image = image
    names = [socket.name for socket in node.outputs]
    check(f"{path.name} is a multilayer image", image.type == "MULTILAYER", f"({image.type}, {size})")
    wanted = {"Combined", "Depth", "range", "return1"} | ({"material"} if path.name == "truth.exr" else set())
    check(f"{path.name} has the passes {', '.join(sorted(wanted))}", wanted <= set(names), f"({', '.join(names)})")
    return tree, node


def depth_through_compositor(path, out):
    """The Depth pass of our file, sent through Blender's compositor into a file of its own; None before Blender 5."""
    tree, node = in_compositor(path)
    scene = bpy.context.scene
    if not hasattr(scene, "compositing_node_group"):
        return None
    output = tree.nodes.new("NodeGroupOutput")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    tree.links.new(node.outputs["Depth"], output.inputs[0])
    scene.compositing_node_group = tree
    scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(out)
    bpy.ops.render.render(write_still=True)
    return channel(out, "R")


def check_grid(path, volume, meta):
    """The grid by OpenVDB, against the npz; gives the density, [z, y, x]."""
    grids, _ = openvdb.readAll(str(path))
    check(f"{path} has one grid, a fog volume", [(g.name, g.gridClass) for g in grids] == [("density", "fog volume")])
    grid, x, y, z = grids[0], volume["x"], volume["y"], volume["z"]
    samples = volume["samples"].astype(np.complex128)
    amplitude = np.hypot(samples.real, samples.imag).astype(np.float32)  # rounded once
    expected = amplitude / amplitude.max()
    threshold = np.float32(10 ** (grid["sonar:thresholdDb"] / 20))
    expected[expected < threshold] = 0
    found = np.full((len(x), len(z), len(y)), np.nan, np.float32)
    grid.copyToArray(found)
    found = found[:, :, ::-1].transpose(1, 2, 0)
    check("every density is |samples| over their peak, 0 below the threshold", np.array_equal(found, expected))
    active = int((expected > 0).sum())
    detail = f"({active} of {expected.size} down to {grid['sonar:thresholdDb']} dB)"
    check("those are the active voxels", grid.activeVoxelCount() == active and grid.background == 0, detail)
    check("the peak is in the metadata", np.float32(grid["sonar:amplitudeScale"]) == amplitude.max())
    same = [grid["sonar:" + name] == meta[key] for name, key in (("soundSpeed", "sound_speed"), ("window", "window"))]
    same += [list(grid["sonar:source"]) == meta["source"], json.loads(grid["sonar:run"]) == meta["run"]]
    check("metadata are those of the npz", all(same), str(same))
    corners = [(i, j, k) for i in (0, len(x) - 1) for j in (0, len(y) - 1) for k in (0, len(z) - 1)]
    to_world = grid.transform.indexToWorld
    off = [np.subtract(to_world((i, k, len(y) - 1 - j)), (x[i], z[k], -y[j])) for i, j, k in corners]
    check("corners are where the npz has them, with z up", np.abs(off).max() < 1e-12, f"({np.abs(off).max():.0e} m)")
    size = volume["pitch"][[0, 2, 1]]
    check("voxels have the pitches as sizes", np.abs(np.subtract(grid.transform.voxelSize(), size)).max() < 1e-15)
    return found


def check_volume_object(path, volume, density):
    """The file as a volume object, and a mesh of its iso-surface."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.object.volume_import(filepath=str(path))
    thing = bpy.context.object
    check("Blender imports a volume", thing.type == "VOLUME" and thing.data.grids.load(), thing.data.grids.error_message)
    names = [(grid.name, grid.data_type, grid.channels) for grid in thing.data.grids]
    check("Blender sees one grid of floats", names == [("density", "FLOAT", 1)], str(names))
    shell = bpy.data.objects.new("shell", bpy.data.meshes.new("shell"))
    bpy.context.collection.objects.link(shell)
    modifier = shell.modifiers.new("shell", "VOLUME_TO_MESH")
    modifier.object, modifier.threshold = thing, 0.5
    mesh = shell.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    points = np.array([vertex.co for vertex in mesh.vertices], np.float64).reshape(-1, 3)
    # Each of its points is between voxels on both sides of the threshold.
    first = [volume[axis][0] for axis in "zyx"]
    place = (points[:, [1, 2, 0]] * [1, -1, 1] - first) / volume["pitch"][[2, 1, 0]]
    padded = np.pad(density, 1)
    low = np.clip(np.floor(place).astype(int) + 1, 0, np.array(padded.shape) - 2)
    near = [padded[tuple((low + [a, b, c]).T)] for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    crossed = (np.max(near, axis=0) >= 0.5) & (np.min(near, axis=0) <= 0.5)
    share = crossed.mean() if len(points) else 0.0
    check("Blender's iso-surface is where the volume crosses it", share > 0.99, f"({share:.4f} of {len(points)} points)")


def check_volume(folder):
    with np.load(folder / "volume.npz") as file:
        volume = {name: file[name] for name in file.files}
    density = check_grid(folder / "volume.vdb", volume, json.loads(bytes(volume["meta"])))
    check_volume_object(folder / "volume.vdb", volume, density)


def flipped(at):
    """The lowest bit of the byte at this place, which may depend on the contents."""

    def damage(raw):
        raw[at(raw)] ^= 1

    return damage


def prove(folder):
    """Damages a copy of a volume in several ways; each must be noticed, or the checks are worth nothing."""
    after = lambda text, more: lambda raw: raw.index(text) + len(text) + more  # noqa: E731
    damages = {
        "none": lambda raw: None,
        "a file cut short": lambda raw: raw.__delitem__(slice(-200, None)),
        "a flipped bit of the last value": flipped(lambda raw: len(raw) - 3),
        "a flipped bit of the translation": flipped(after(b"ScaleTranslateMap", 4)),
        "a flipped bit of the scale": flipped(after(b"ScaleTranslateMap", 28)),
        "a flipped bit of the peak": flipped(after(b"sonar:amplitudeScale\x06\0\0\0double", 8)),
        "another class": flipped(after(b"fog ", 1)),
    }
    wrong = []
    for what, damage in damages.items():
        with tempfile.TemporaryDirectory() as temporary:
            copy = Path(temporary)
            shutil.copy(folder / "volume.npz", copy)
            raw = bytearray((folder / "volume.vdb").read_bytes())
            damage(raw)
            (copy / "volume.vdb").write_bytes(raw)
            run = subprocess.run([sys.executable, __file__, "--volume", temporary], capture_output=True, text=True)
            if (run.returncode == 0) != (what == "none"):
                wrong.append(what)
                print(run.stdout, run.stderr)
            lines = (run.stdout + run.stderr).strip().splitlines()
            noticed = [line for line in lines if line.startswith("FAILED")] or lines[-1:]
            print(f"damaged by {what}: {noticed[0].replace(temporary + '/', '')}", flush=True)
    print(f"{len(damages) - len(wrong)} passed, {len(wrong)} failed")
    sys.exit(1 if wrong else 0)


def main():
    if sys.argv[1] == "--prove":
        prove(Path(sys.argv[2]).resolve())
    if sys.argv[1] == "--volume":
        for folder in sys.argv[2:]:
            check_volume(Path(folder).resolve())
        sys.exit(1 if failed else 0)
    mesh, camera, folder = Path(sys.argv[1]).resolve(), sys.argv[2], Path(sys.argv[3]).resolve()
    print("Blender", bpy.app.version_string)
    truth = channel(folder / "truth.exr", "Z")
    compare(truth, render(mesh, camera, truth.shape, folder / "blender.exr"))
    in_compositor(folder / "truth.exr")
    depth = channel(folder / "depth.exr", "Z")
    through = depth_through_compositor(folder / "depth.exr", folder / "blender_depth.exr")
    if through is not None:
        found = np.isfinite(depth)
        same = through.shape == depth.shape and np.array_equal(through[found], depth[found])
        detail = "" if same else f"({through.shape}; {through[found][:3]}, expected {depth[found][:3]})"
        check("the compositor's Depth is Z of depth.exr, in metres", same and found.any(), detail)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
