#!/usr/bin/env python3
"""Holds a perspective truth to Blender's own Z pass, and opens depth maps in Blender's compositor.

    check_blender.py MESH.gltf CAMERA OUTDIR

OUTDIR is a result of `holosonar image` whose array sits at the camera of this name, in its perspective view. Blender (the
module bpy from PyPI) imports the file and renders it from that camera with Cycles, one sample through each pixel's centre.
Its depth must be that of truth.exr, to 0.1 mm at 99.5 % of the pixels; pixels beside a jump in depth are left out, since
there a hair's breadth decides between two surfaces. The render is left as OUTDIR/blender.exr. Exit status 1 if a check fails.
"""

import sys
from pathlib import Path

import bpy
import numpy as np
import OpenEXR

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


def main():
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
