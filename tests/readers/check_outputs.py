#!/usr/bin/env python3
"""Reads the files of `holosonar image` with other people's readers and compares them value by value.

    check_outputs.py OUTDIR [OUTDIR ...]
    check_outputs.py --prove OUTDIR    damages copies of a result (with Zarr, VTI, NRRD and points) and sees that it is noticed

OpenEXR and OpenImageIO read the EXR files, NumPy the npz, zarr-python, xarray and (if it is installed) tensorstore the Zarr
store, pynrrd the NRRD, plyfile the PLY, VTK (if it is installed) and a few lines of our own the VTI. The program under test takes no part. One line per check that fails, exit status 1 if there is any.
"""

import json
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import nrrd
import numpy as np
import OpenEXR
import OpenImageIO as oiio
import plyfile
import xarray
import zarr

try:
    import tensorstore
except ImportError:
    tensorstore = None
try:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader
except ImportError:
    vtkXMLImageDataReader = None

passed = 0
failed = []


def check(place, what, holds, detail=""):
    """Counts one check and prints it if it fails."""
    global passed
    if bool(holds):
        passed += 1
    else:
        failed.append(what)
        print(f"FAILED {place}: {what} {detail}".rstrip(), flush=True)


def equal(place, what, found, expected):
    """Equal bit for bit, NaN with NaN; says where the first difference is."""
    found, expected = np.asarray(found), np.asarray(expected)
    if found.shape != expected.shape:
        check(place, what, False, f"(shape {found.shape}, expected {expected.shape})")
        return
    same = (found == expected) | ((found != found) & (expected != expected))
    detail = ""
    if not same.all():
        at = tuple(int(i) for i in np.argwhere(~same)[0])
        detail = f"({np.count_nonzero(~same)} differ; at {at}: {found[at]}, expected {expected[at]})"
    check(place, what, same.all(), detail)


def close(place, what, found, expected, relative):
    """Equal to a relative error, infinities in the same places."""
    found, expected = np.asarray(found, np.float64), np.asarray(expected, np.float64)
    good = found.shape == expected.shape and np.allclose(found, expected, rtol=relative, atol=0, equal_nan=True)
    check(place, what, good)


def number(header, name):
    """A scalar attribute, however the reader wraps it."""
    return float(np.asarray(header[name]).reshape(-1)[0])


def parts(path):
    """(name, header, {channel: pixels}) of every part."""
    file = OpenEXR.File(str(path), separate_channels=True)
    return [
        (part.header.get("name", ""), part.header, {name: c.pixels for name, c in part.channels.items()})
        for part in file.parts
    ]


def same_attribute(ours, theirs):
    """Whether two readers hand out the same value, each in its own wrapping; OpenImageIO rounds doubles to six digits."""
    if isinstance(theirs, str):
        return str(ours) == theirs
    ours, theirs = (np.asarray(value, np.float64).reshape(-1) for value in (ours, theirs))
    return ours.shape == theirs.shape and np.allclose(ours, theirs, rtol=1e-5, atol=1e-12, equal_nan=True)


def check_with_oiio(path):
    """OpenImageIO finds the very numbers and attributes that OpenEXR finds, and its tool reads every pixel."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        check(path, "OpenImageIO opens it", False, f"({oiio.geterror()})")
        return
    for index, (name, header, channels) in enumerate(parts(path)):
        what = f"OpenImageIO: part {name or index}"
        check(path, f"{what} is there", image.seek_subimage(index, 0))
        spec = image.spec()
        check(path, f"{what} has the same channels", set(spec.channelnames) == set(channels), str(spec.channelnames))
        # Whether a truncated file is noticed: reading fails, where headers alone would be fine.
        pixels = image.read_image(index, 0, 0, spec.nchannels, oiio.FLOAT)
        check(path, f"{what} can be read", pixels is not None, f"({image.geterror()})")
        if pixels is None:
            continue
        for k, channel in enumerate(spec.channelnames):
            equal(path, f"{what} {channel}", pixels[..., k], channels[channel].astype(np.float32))
        for key in (key for key in header if key.startswith("sonar:")):
            theirs = spec.getattribute(key)
            check(path, f"{what} attribute {key}", theirs is not None and same_attribute(header[key], theirs),
                  f"({header[key]}, {theirs})")  # fmt: skip
    check(path, "OpenImageIO finds no further part", not image.seek_subimage(index + 1, 0))
    image.close()
    tool = shutil.which("oiiotool", path=str(Path(sys.executable).parent)) or shutil.which("oiiotool")
    if tool is None:
        check(path, "oiiotool is there", False)
        return
    stats = subprocess.run([tool, "--stats", "-a", str(path)], capture_output=True, text=True)
    said = stats.stdout.count("FiniteCount")
    check(path, "oiiotool --stats reads every part", stats.returncode == 0 and said == index + 1, f"({stats.stderr})")
    # The Z of a depth map is the same picture after a round through OpenImageIO's own writer.
    with tempfile.TemporaryDirectory() as folder:
        copy = str(Path(folder) / "copy.exr")
        # Where nothing was found Z is infinite, and inf - inf would be called a difference.
        calm = ["--fixnan", "black", "--ch", "R,G,B,A,Z"]
        subprocess.run([tool, str(path), "--subimage", "0", *calm, "-d", "float", "-o", copy], capture_output=True)
        same = subprocess.run([tool, str(path), "--subimage", "0", *calm, copy, "--diff"], capture_output=True, text=True)
        check(path, "oiiotool --diff finds a copy equal", same.returncode == 0 and "PASS" in same.stdout, same.stdout)


def amplitude(samples):
    """|samples|, rounded to float32 once."""
    exact = np.hypot(samples.real.astype(np.float64), samples.imag.astype(np.float64))
    return exact.astype(np.float32)


def check_volume_exr(folder, volume, output):
    """Every depth of volume.exr (and its continuations) against the npz."""
    half = output["float16"] and 0.01 <= np.abs(volume["samples"]).max() <= 6e4
    # Half floats round to eleven bits.
    kind, error = (np.float16, 2.0**-11) if half else (np.float32, 0.0)
    complex_too = output["components"] == "complex"
    samples, x, y, z = (volume[name] for name in ("samples", "x", "y", "z"))
    expected = amplitude(samples)
    files = [folder / "volume.exr"] + sorted(folder.glob("volume.[0-9]*.exr"))
    depth_index = 0
    for path in files:
        all_parts = parts(path)
        name, header, mip = all_parts[0]
        check(path, "part 0 is called mip", name == "mip", name)
        check(path, "mip has R, G, B, A, Z", set(mip) == set("RGBAZ"), str(set(mip)))
        greatest = expected.max(axis=0)
        # Rounded twice (power, then root), so the last bit may differ.
        close(path, "mip R is the greatest amplitude along z", mip["R"], greatest, 3e-7 + error)
        for same in "GB":
            equal(path, f"mip {same} = R", mip[same], mip["R"])
        equal(path, "mip A = 1", mip["A"], np.ones_like(mip["A"]))
        where = np.abs(z[None, None, :] - mip["Z"][:, :, None]).argmin(axis=2)
        at_z = np.take_along_axis(expected, where[None], axis=0)[0]
        close(path, "mip Z is where that amplitude is", at_z, greatest, 3e-7)
        for key, value in (
            ("sonar:gridOrigin", [x[0], y[0], z[0]]),
            ("sonar:gridPitch", volume["pitch"]),
            ("sonar:gridShape", samples.shape[::-1]),
        ):
            equal(path, f"attribute {key}", np.asarray(header[key], np.float64), np.asarray(value, np.float64))
        for name, header, channels in all_parts[1:]:
            check(path, "the parts are called z0000, z0001, ...", name == f"z{depth_index:04}", name)
            wanted = {"Y", "re", "im"} if complex_too else {"Y"}
            check(path, f"{name} holds {', '.join(sorted(wanted))}", set(channels) == wanted, str(set(channels)))
            check(path, f"{name} Y is of the type asked for", channels["Y"].dtype == kind, str(channels["Y"].dtype))
            check(path, f"{name} says its depth", abs(number(header, "sonar:depth") - z[depth_index]) < 1e-12)
            if half:
                off = np.abs(channels["Y"].astype(np.float64) - expected[depth_index])
                # Below 6e-5 half floats have even steps.
                check(path, f"{name} = |samples|, to 11 bits", (off <= error * expected[depth_index] + 3e-8).all())
            else:
                equal(path, f"{name} = |samples[{depth_index}]|", channels["Y"], expected[depth_index])
            if complex_too:
                equal(path, f"{name} re", channels["re"], samples[depth_index].real)
                equal(path, f"{name} im", channels["im"], samples[depth_index].imag)
            depth_index += 1
    check(folder, "as many parts as depths", depth_index == len(z), f"({depth_index}, {len(z)})")


COMMON_ATTRIBUTES = [
    "amplitudeScale", "view", "x0", "y0", "pitch", "pitchY", "depth", "unit", "noReturn", "program", "soundSpeed",
    "startFrequency", "bandwidth", "frequencyStep", "frequencies", "microphones", "arrayCentre", "arrayExtent",
    "geometry", "source", "detection", "window", "tolerance", "rangeResolution", "seed", "run",
]  # fmt: skip

OUR_AXES_TO_EXR = np.diag([1.0, -1.0, 1.0, 1.0])  # left-handed, y up


def check_depth_exr(path, volume, fill, half=False):
    """The channels of a depth map or truth against each other and the file's attributes."""
    all_parts = parts(path)
    check(path, "one part", len(all_parts) == 1)
    _, header, ch = all_parts[0]
    for name in COMMON_ATTRIBUTES:
        check(path, f"attribute sonar:{name}", f"sonar:{name}" in header)
    for name, pixels in ch.items():
        wanted = np.float16 if half and name in "RGB" else np.float32
        check(path, f"{name} is of the type asked for", pixels.dtype == wanted, str(pixels.dtype))
    for same in "GB":
        equal(path, f"{same} = R", ch[same], ch["R"])
    accepted = ch["A"] == 1
    check(path, "A is 0 or 1", ((ch["A"] == 0) | accepted).all())
    check(path, "Z is finite where A = 1", np.isfinite(ch["Z"][accepted]).all())
    check(path, "Z > 0 where A = 1", (ch["Z"][accepted] > 0).all())
    for name in ["Z", "range.V"]:
        equal(path, f"{name} is the fill where A = 0", ch[name][~accepted], np.full((~accepted).sum(), fill))
    check(path, "R = 0 where A = 0", (ch["R"][~accepted] == 0).all())
    check(path, "0 <= R <= 1", ((ch["R"] >= 0) & (ch["R"] <= 1)).all())
    equal(path, "sonar:noReturn is the fill", number(header, "sonar:noReturn"), np.float64(fill))
    rows, columns = ch["Z"].shape
    xs = number(header, "sonar:x0") + number(header, "sonar:pitch") * np.arange(columns)
    ys = number(header, "sonar:y0") + number(header, "sonar:pitchY") * np.arange(rows)
    z = ch["Z"].astype(np.float64)
    if header["sonar:view"] == "perspective":
        # Slopes, so that a pixel's x grows with its depth; the window at distance 1 is as wide as the pixels.
        along_ray = z * np.sqrt(xs[None, :] ** 2 + ys[:, None] ** 2 + 1.0)
        window = number(header, "sonar:pitch") * columns
        close(path, "screenWindowWidth is that of the slopes", number(header, "screenWindowWidth"), window, 1e-6)
        field = 2 * np.degrees(np.arctan(0.5 * number(header, "sonar:pitchY") * rows))
        close(path, "fieldOfViewY is that of the slopes", number(header, "sonar:fieldOfViewY"), field, 1e-9)
    else:
        along_ray = np.sqrt(xs[None, :] ** 2 + ys[:, None] ** 2 + z**2)
        close(path, "the columns are at the volume's x", xs, volume["x"], 1e-9)
        close(path, "the rows are at the volume's y", ys, volume["y"], 1e-9)
    close(path, "range.V is the distance from the origin", ch["range.V"][accepted], along_ray[accepted], 1e-6)
    if "N.X" in ch:
        normals = np.stack([ch[f"N.{axis}"] for axis in "XYZ"], axis=-1).astype(np.float64)
        close(path, "unit normals", np.linalg.norm(normals[accepted], axis=1), np.ones(accepted.sum()), 1e-6)
        check(path, "no normal where A = 0", (normals[~accepted] == 0).all())
    if "error.V" in ch:
        check(path, "error.V > 0 where A = 1", (ch["error.V"][accepted] > 0).all())
        check(path, "error.V = 0 where A = 0", (ch["error.V"][~accepted] == 0).all())
    for name in [n for n in ch if n.endswith(".id")]:
        ids, names = ch[name], json.loads(header["sonar:materials"])
        depth = ch["Z"] if name == "material.id" else ch[name.replace(".id", ".Z")]
        check(path, f"{name} counts the names", np.isin(ids, np.arange(len(names) + 1)).all())
        there = accepted if name == "material.id" else (
            np.isfinite(depth) if not np.isfinite(fill) else ch[name.replace(".id", ".V")] > 0
        )
        check(path, f"{name} is 0 exactly where nothing is", ((ids > 0) == there).all())
    equal(path, "worldToCamera turns our axes into OpenEXR's", header["worldToCamera"], OUR_AXES_TO_EXR)
    check(path, "the unit is m", header["sonar:unit"] == "m")
    resolved = json.loads(header["sonar:run"])
    check(path, "sonar:run is the resolved run file", {"scene", "sweep", "depth"} <= set(resolved))
    k = 1
    nearer = None
    while f"return{k}.Z" in ch:
        found = np.isfinite(ch[f"return{k}.Z"]) if not np.isfinite(fill) else ch[f"return{k}.V"] > 0
        check(path, f"return{k}.V = 0 where there is none", (ch[f"return{k}.V"][~found] == 0).all())
        if nearer is not None:
            behind = ch[f"return{k}.Z"] > ch[f"return{k - 1}.Z"]
            check(path, f"return {k} is behind return {k - 1}", behind[found].all())
            check(path, f"return {k} only with return {k - 1}", nearer[found].all())
        nearer = found
        k += 1
    return header, ch


def along_rays(magnitude, header, shape, volume):
    """[z, row, column]: the root of the power, interpolated where each pixel's ray meets each depth."""
    slopes = [number(header, f"sonar:{a}0") + number(header, f"sonar:{p}") * np.arange(n)
              for a, p, n in (("y", "pitchY", shape[0]), ("x", "pitch", shape[1]))]  # fmt: skip
    planes = []
    for z, plane in zip(volume["z"], magnitude.astype(np.float64) ** 2):
        for axis, (name, slope) in enumerate(zip("yx", slopes)):
            at = (slope * z - volume[name][0]) / (volume[name][1] - volume[name][0])
            below = np.clip(np.floor(at).astype(int), 0, len(volume[name]) - 2)
            lower, upper = np.take(plane, below, axis), np.take(plane, below + 1, axis)
            share = np.expand_dims(at - below, 1 - axis)
            plane = np.where((share >= 0) & (share <= 1), lower + (upper - lower) * share, 0.0)
        planes.append(np.sqrt(plane))
    return np.stack(planes)


def check_depth_against_volume(path, header, ch, volume):
    """Finds the depths again, coarsely: the greatest amplitude near Z is close to Z, and no mere sidelobe.

    It need not be the greatest of its column: the power around a pixel may choose the other one of two surfaces.
    """
    magnitude = np.abs(volume["samples"])
    if header["sonar:view"] == "perspective":
        magnitude = along_rays(magnitude, header, ch["Z"].shape, volume)
    accepted = ch["A"] == 1
    cell = number(header, "sonar:rangeResolution")
    off = np.abs(volume["z"][:, None, None] - np.where(accepted, ch["Z"], np.inf)[None])
    near = np.where(off <= 2.0 * cell, magnitude, 0.0)
    peak = near.argmax(axis=0)
    at_peak = np.take_along_axis(off, peak[None], axis=0)[0] <= 1.75 * cell
    strong = near.max(axis=0) >= 10 ** (-12 / 20) * magnitude.max(axis=0)
    share = (at_peak & strong)[accepted].mean() if accepted.any() else 1.0
    check(path, "Z is at a strong return of the volume in 95 % of the pixels", share >= 0.95, f"({share:.3f})")


def check_nrrd(path, volume):
    """The NRRD by pynrrd."""
    samples = volume["samples"]
    try:
        data, header = nrrd.read(str(path), index_order="C")
    except (nrrd.NRRDError, zlib.error) as error:
        check(path, "pynrrd reads it", False, f"({error})")
        return
    check(path, "float32", data.dtype == np.float32, str(data.dtype))
    equal(path, "amplitude = |samples|, [z, y, x]", data, amplitude(samples))
    equal(path, "space origin", header["space origin"], [volume[axis][0] for axis in "xyz"])
    equal(path, "space directions", header["space directions"], np.diag(volume["pitch"]))
    check(path, "space units are m", [unit.strip('"') for unit in header["space units"]] == ["m"] * 3)
    check(path, "it names the sound speed", float(header["sonar.soundSpeed"]) > 0)
    resolved = json.loads(header["sonar.run"].replace("\\\\", "\\"))
    check(path, "sonar:run is the resolved run file", {"scene", "sweep", "depth"} <= set(resolved))


def maxima(values):
    """The greatest of two by two by two values; the last of an odd number is alone."""
    for axis in range(values.ndim):
        if values.shape[axis] > 1:
            values = np.maximum.reduceat(values, np.arange(0, values.shape[axis], 2), axis=axis)
    return values


def check_zarr(path, volume, meta, output):
    """The Zarr store by zarr-python, xarray and tensorstore, and its pyramid against the definition."""
    group = zarr.open_group(str(path), mode="r")
    complex_too = output["components"] == "complex"
    expected = {"amplitude": amplitude(volume["samples"]), "pitch": volume["pitch"]}
    expected |= {axis: volume[axis] for axis in "zyx"} | ({"samples": volume["samples"]} if complex_too else {})
    arrays = dict(group.arrays())
    check(path, "arrays " + ", ".join(sorted(expected)), set(arrays) == set(expected), str(set(arrays)))
    for name, values in expected.items():
        check(path, f"{name} is of the type of the npz", arrays[name].dtype == values.dtype, str(arrays[name].dtype))
        equal(path, f"{name} by zarr-python", arrays[name][...], values)
    for name in set(expected) & {"amplitude", "samples"}:
        array = arrays[name]
        check(path, f"{name} has the dimensions z, y, x", array.metadata.dimension_names == ("z", "y", "x"))
        slabs = -(-array.shape[0] // array.shards[0])
        files = [file for file in (path / name).rglob("*") if file.is_file()]
        check(path, f"{name} is in one file for each slab of depths", len(files) == 1 + slabs, f"({len(files)})")
    check(path, "the attribute meta is that of the npz", group.attrs["meta"] == meta)

    ome = group.attrs["ome"]
    image = ome["multiscales"][0]
    check(path, "OME-NGFF 0.5", ome["version"] == "0.5")
    axes = [{"name": name, "type": "space", "unit": "meter"} for name in "zyx"]
    check(path, "axes in m", image["axes"] == axes, str(image["axes"]))
    values = expected["amplitude"]
    edges = {axis: volume[axis] for axis in "zyx"}
    for k, level in enumerate(image["datasets"]):
        if k:
            values = maxima(values)
            edges = {axis: (at + np.r_[at[1:], 2 * at[-1:] - at[-2:-1]])[::2] / 2 if len(at) > 1 else at
                     for axis, at in edges.items()}  # fmt: skip
        equal(path, f"level {k}: the maxima of the one before", group[level["path"]][...], values)
        scale, move = (t[kind] for t, kind in zip(level["coordinateTransformations"], ("scale", "translation")))
        for axis, n, pitch, first in zip("zyx", values.shape, scale, move):
            close(path, f"level {k}: {axis}", first + pitch * np.arange(n) + 10.0, edges[axis] + 10.0, 1e-9)
        part = str(Path(level["path"]).parent)
        opened = xarray.open_zarr(str(path), group=None if part == "." else part, consolidated=False)
        equal(path, f"level {k} by xarray", opened.amplitude.values, values)
        for axis in "zyx":
            close(path, f"level {k}: xarray's {axis}", opened.amplitude[axis].values + 10.0, edges[axis] + 10.0, 1e-9)
        if tensorstore is not None:
            spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(path / level["path"])}}
            equal(path, f"level {k} by tensorstore", tensorstore.open(spec).result().read().result(), values)
    check(path, "levels down to 64 voxels along each axis", max(values.shape) <= 64, str(values.shape))
    if complex_too and tensorstore is not None:
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(path / "samples")}}
        equal(path, "samples by tensorstore", tensorstore.open(spec).result().read().result(), volume["samples"])


def check_depth_ply(path, found):
    """The points by plyfile, against depth.exr: one vertex per accepted pixel, in their order."""
    header, ch = found
    points = plyfile.PlyData.read(str(path))["vertex"]
    names = [p.name for p in points.properties]
    check(path, "x, y, z, nx, ny, nz, amplitude", names == ["x", "y", "z", "nx", "ny", "nz", "amplitude"], str(names))
    accepted = ch["A"] == 1
    rows, columns = np.nonzero(accepted)
    check(path, "one vertex per accepted pixel", len(points) == len(rows), f"({len(points)}, {len(rows)})")
    perspective = header["sonar:view"] == "perspective"
    far = ch["Z"][accepted].astype(np.float64) if perspective else 1.0
    x = (number(header, "sonar:x0") + number(header, "sonar:pitch") * columns) * far
    y = (number(header, "sonar:y0") + number(header, "sonar:pitchY") * rows) * far
    equal(path, "x", points["x"], x.astype(np.float32))
    equal(path, "y", points["y"], y.astype(np.float32))
    equal(path, "z", points["z"], ch["Z"][accepted])
    strength = ch["R"][accepted].astype(np.float64) * number(header, "sonar:amplitudeScale")
    close(path, "amplitude", points["amplitude"], strength, 1e-6 if ch["R"].dtype == np.float32 else 6e-4)
    normals = np.stack([points["nx"], points["ny"], points["nz"]], axis=1).astype(np.float64)
    close(path, "unit normals", np.linalg.norm(normals, axis=1), np.ones(len(normals)), 1e-6)
    check(path, "normals turned to the array", (normals[:, 2] < 0).all())
    for k, axis in enumerate("XYZ"):
        if "N.X" in ch:
            equal(path, f"n{axis.lower()}", points[f"n{axis.lower()}"], ch[f"N.{axis}"][accepted])
    # Where all nine depths are on one smooth surface, central differences give nearly the same.
    z = np.where(accepted, ch["Z"], np.nan).astype(np.float64)
    slopes = np.full((2, *z.shape), np.nan)
    inner = z[1:-1, 1:-1] if perspective else 1.0
    slopes[0][1:-1, 1:-1] = (z[1:-1, 2:] - z[1:-1, :-2]) / (2 * number(header, "sonar:pitch") * inner)
    slopes[1][1:-1, 1:-1] = (z[2:, 1:-1] - z[:-2, 1:-1]) / (2 * number(header, "sonar:pitchY") * inner)
    rough = np.stack([slopes[0], slopes[1], -np.ones_like(z)], axis=-1)[accepted]
    smooth = np.isfinite(rough).all(axis=1) & (np.abs(rough[:, :2]).max(axis=1) < 1)
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    if smooth.sum() > 50:
        along = (rough * normals).sum(axis=1)[smooth]
        check(path, "normals near those of central differences", np.median(along) > 0.95, f"({np.median(along):.3f})")


def check_scene_ply(path, report, header):
    """Reflectors, microphones and speaker by plyfile."""
    points = plyfile.PlyData.read(str(path))["vertex"]
    counts = np.bincount(points["kind"], minlength=3)
    check(path, "every reflector", counts[0] == (report["reflectors"] or 0), str(counts))
    check(path, "every microphone", counts[1] == report["plan"]["microphones"], str(counts))
    monostatic = header["sonar:geometry"] == "monostatic"
    check(path, "the speaker", counts[2] == (0 if monostatic else 1), str(counts))
    at = np.stack([points["x"], points["y"], points["z"]], axis=1).astype(np.float64)
    mics = at[points["kind"] == 1]
    silent = (points["kind"] == 1) | (points["kind"] == 2)
    check(path, "only reflectors and bounces have an amplitude", (points["amplitude"][silent] == 0).all())
    extent, centre = (np.asarray(header[f"sonar:{name}"], np.float64) for name in ("arrayExtent", "arrayCentre"))
    check(path, "the array's extent", np.allclose(np.ptp(mics, axis=0), extent, atol=1e-6))
    check(path, "the array's centre", np.allclose((mics.min(axis=0) + mics.max(axis=0)) / 2, centre, atol=1e-6))
    if report["run"]["array"]["layout"] == "grid":
        places = {tuple(p) for p in mics.round(6).tolist()}
        across = [len(set(mics[:, axis].round(6).tolist())) for axis in (0, 1)]
        check(path, "a full rectangle of microphones", len(places) == across[0] * across[1] == counts[1], str(across))
    if report["scene"] and counts[0]:
        reflectors, scene = at[points["kind"] == 0], report["scene"]
        inside = (reflectors >= np.array(scene["low"]) - 1e-5) & (reflectors <= np.array(scene["high"]) + 1e-5)
        check(path, "reflectors within the scene's box", inside.all() or report["run"]["reflectors"]["surface"] == "rough")
        check(path, "reflectors have amplitudes", (points["amplitude"][points["kind"] == 0] > 0).mean() > 0.5)


def check_mesh_ply(path, report):
    """The decimated mesh by plyfile: its parts, and the box and the area of the scene."""
    mesh = plyfile.PlyData.read(str(path))
    vertices, faces = mesh["vertex"], mesh["face"]
    at = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    corners = np.stack(faces["vertex_indices"])
    check(path, "triangles", corners.shape == (len(faces), 3), str(corners.shape))
    check(path, "no more triangles than the scene has", len(faces) <= report["scene"]["triangles"])
    check(path, "corners are vertices, and every vertex is one", (np.unique(corners) == np.arange(len(at))).all())
    names = [comment.split(" ", 2) for comment in mesh.comments if comment.startswith("part ")]
    check(path, "a name for every part", [int(k) for _, k, _ in names] == list(range(len(names))), str(names))
    check(path, "names are JSON", all(isinstance(json.loads(name), str) for _, _, name in names))
    part = faces["part"]
    check(path, "the triangles of one part after those of another", (np.diff(part) >= 0).all() and part.max() < len(names))
    scene = report["scene"]
    near = 0.02 * max(scene["size"])
    for end, found in (("low", at.min(axis=0)), ("high", at.max(axis=0))):
        check(path, f"the scene's box: {end}", np.allclose(found, scene[end], atol=near), f"({found}, {scene[end]})")
    a, b, c = (at[corners[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    check(path, "the scene's area", abs(area / scene["area"] - 1) < 0.05, f"({area}, {scene['area']})")


def check_vti(path, volume, complex_too):
    """The VTI by hand: XML header, raw appended arrays; then by VTK."""
    raw = path.read_bytes()
    start = raw.index(b'<AppendedData encoding="raw">')
    start = raw.index(b"_", start) + 1
    text = raw[:start].decode()
    image = re.search(r'<ImageData WholeExtent="([^"]*)" Origin="([^"]*)" Spacing="([^"]*)"', text)
    extent, origin, spacing = (np.array([float(v) for v in group.split()]) for group in image.groups())
    samples = volume["samples"]
    n_z, n_y, n_x = samples.shape
    equal(path, "WholeExtent", extent, [0, n_x - 1, 0, n_y - 1, 0, n_z - 1])
    equal(path, "Origin", origin, [volume["x"][0], volume["y"][0], volume["z"][0]])
    equal(path, "Spacing", spacing, volume["pitch"])
    check(path, "UInt64 lengths, little-endian", 'header_type="UInt64"' in text and "LittleEndian" in text)
    arrays = {}
    for name, offset in re.findall(r'type="Float32" Name="(\w+)" format="appended" offset="(\d+)"', text):
        at = start + int(offset)
        (length,) = struct.unpack_from("<Q", raw, at)
        check(path, f"length of {name}", length == 4 * samples.size, str(length))
        arrays[name] = np.frombuffer(raw, "<f4", samples.size, at + 8).reshape(samples.shape)
    wanted = {"amplitude", "re", "im"} if complex_too else {"amplitude"}
    check(path, f"arrays {', '.join(sorted(wanted))}", set(arrays) == wanted, str(set(arrays)))
    if complex_too:
        equal(path, "re = samples.real", arrays.get("re"), samples.real)
        equal(path, "im = samples.imag", arrays.get("im"), samples.imag)
    equal(path, "amplitude = |samples|", arrays.get("amplitude"), amplitude(samples))
    if vtkXMLImageDataReader is None:
        return
    reader = vtkXMLImageDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    equal(path, "VTK: dimensions", data.GetDimensions(), (n_x, n_y, n_z))
    equal(path, "VTK: origin", data.GetOrigin(), origin)
    equal(path, "VTK: spacing", data.GetSpacing(), spacing)
    found = vtk_to_numpy(data.GetPointData().GetArray("amplitude")).reshape(samples.shape)
    equal(path, "VTK: amplitude = |samples|", found, amplitude(samples))


def check_png(path):
    """Signature, header chunk, plausible size, the end chunk."""
    raw = path.read_bytes()
    check(path, "PNG signature", raw[:8] == b"\x89PNG\r\n\x1a\n")
    check(path, "IHDR comes first", raw[12:16] == b"IHDR")
    width, height = struct.unpack(">II", raw[16:24])
    check(path, "a picture of sane size", 200 <= width <= 4000 and 200 <= height <= 4000, f"({width} x {height})")
    check(path, "IEND comes last", raw[-8:-4] == b"IEND")


def check_report(path, report, volume):
    """report.json against the folder and the volume."""
    present = {p.name for p in path.parent.iterdir() if not p.name.startswith(".")}
    check(path, "lists every file of the folder", set(report["files"]) == present, str(present ^ set(report["files"])))
    equal(path, "plan.grid_shape", report["plan"]["grid_shape"], volume["samples"].shape)
    peak = np.abs(volume["samples"]).max()
    close(path, "peak_amplitude", report["peak_amplitude"], peak, 1e-6)
    metrics = report["metrics"] or {}
    for name in ("completeness", "false_returns", "two_returns", "spurious_returns"):
        value = metrics.get(name)
        check(path, f"{name} is a share", value is None or 0 <= value <= 1)
    check(path, "has a truth exactly if it has metrics", ("truth.exr" in present) == bool(metrics))
    check(path, "every stage took some time", all(v >= 0 for v in report["timings"].values()))


def check_metrics(path, report, found, truth):
    """Completeness and median error, computed again from depth.exr and truth.exr."""
    resolution = report["plan"]["range_resolution"]
    surfaces = [truth[name] for name in sorted(truth) if re.fullmatch(r"return\d+\.Z", name)] or [truth["Z"]]
    surfaces = [np.where(np.isfinite(s), s, np.nan).astype(np.float64) for s in surfaces]
    z = np.where(found["A"] == 1, found["Z"], np.nan).astype(np.float64)
    errors = np.abs(np.stack([z - s for s in surfaces]))
    errors = np.where(np.isnan(errors), np.inf, errors).min(axis=0)
    has_surface = np.any([np.isfinite(s) for s in surfaces], axis=0)
    completeness = (errors[has_surface] < resolution).mean()
    check(path, "completeness, computed again", abs(completeness - report["metrics"]["completeness"]) < 1e-9,
          f"({completeness}, {report['metrics']['completeness']})")  # fmt: skip
    scored = errors[has_surface & np.isfinite(errors)]
    rmse = float(np.sqrt((scored**2).mean()))
    check(path, "rmse, computed again", abs(rmse - report["metrics"]["rmse"]) < 1e-6 * rmse, f"({rmse})")


def check_folder(folder):
    """Every file of one result."""
    folder = Path(folder)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    with np.load(folder / "volume.npz", allow_pickle=False) as file:
        volume = {name: file[name] for name in file.files}
    place = folder / "volume.npz"
    check(place, "complex64 samples", volume["samples"].dtype == np.complex64)
    shape = tuple(len(volume[name]) for name in ("z", "y", "x"))
    check(place, "samples are [z, y, x]", volume["samples"].shape == shape)
    meta = json.loads(bytes(volume["meta"]).decode("utf-8"))
    check(place, "meta names the sound speed", meta["sound_speed"] > 0)
    check_report(folder / "report.json", report, volume)

    output = report["run"]["output"]
    formats = output["formats"]
    if "exr" in formats:
        check_volume_exr(folder, volume, output)
    if "zarr" in formats:
        check_zarr(folder / "volume.zarr", volume, meta, output)
    if "vti" in formats:
        check_vti(folder / "volume.vti", volume, output["components"] == "complex")
    if "nrrd" in formats:
        check_nrrd(folder / "volume.nrrd", volume)
    fill = report["run"]["depth"]["fill"]
    fill = np.float32({"inf": np.inf, "nan": np.nan}.get(fill, fill))
    header, found = check_depth_exr(folder / "depth.exr", volume, fill, output["float16"])
    close(folder / "depth.exr", "accepted pixels as reported", (found["A"] == 1).sum(), report["accepted"], 0)
    check_depth_against_volume(folder / "depth.exr", header, found, volume)
    if output["points"]:
        check_depth_ply(folder / "depth.ply", (header, found))
        check_scene_ply(folder / "scene.ply", report, header)
        if report["metrics"]:
            check_mesh_ply(folder / "mesh.ply", report)
    second = found.get("return2.V", np.zeros(1)).max() > 0
    listed = "depth_return2.png" in report["files"]
    check(folder, "a figure of second returns exactly if there are some", listed == second, f"({listed}, {second})")
    if report["metrics"]:
        _, truth = check_depth_exr(folder / "truth.exr", volume, fill, output["float16"])
        check_metrics(folder / "report.json", report, found, truth)
    for name in report["files"]:
        if name.endswith(".png"):
            check_png(folder / name)
        if name.endswith(".exr"):
            check_with_oiio(folder / name)


def damage_npz(folder):
    """One sample of the volume, changed in its last bits."""
    with np.load(folder / "volume.npz") as file:
        arrays = {name: file[name].copy() for name in file.files}
    arrays["samples"][1, 2, 3] *= np.float32(1.000001)
    np.savez(folder / "volume.npz", **arrays)


def damage_depth(folder):
    """One accepted depth, 1 mm farther."""
    file = OpenEXR.File(str(folder / "depth.exr"), separate_channels=True)
    channels = file.channels()
    z = channels["Z"].pixels
    z[tuple(np.argwhere(channels["A"].pixels == 1)[0])] += 0.001
    # Rewritten from its arrays: as the reader hands headers out, not all of them can be written back.
    kept = {k: v for k, v in file.header().items() if k.startswith("sonar:") or k == "worldToCamera"}
    kept |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(kept, {name: c.pixels for name, c in channels.items()}).write(str(folder / "depth.exr"))


def damage_byte(name, place):
    """One bit of a file."""

    def damage(folder):
        raw = bytearray((folder / name).read_bytes())
        raw[place] ^= 1
        (folder / name).write_bytes(raw)

    return damage


def cut_short(name, missing):
    """A file without its last bytes, whose headers are whole."""

    def damage(folder):
        raw = (folder / name).read_bytes()
        (folder / name).write_bytes(raw[:-missing])

    return damage


def prove(folder):
    """Damages a copy of a result in several ways; each must be noticed, or the checks are worth nothing."""
    damages = {
        "a changed sample": damage_npz,
        "a changed depth": damage_depth,
        "a depth.exr cut short": cut_short("depth.exr", 200),
        "a volume.exr cut short": cut_short("volume.exr", 200),
        "a flipped bit of a shard": damage_byte("volume.zarr/amplitude/c/1/0/0", 5000),
        "a flipped bit of a shard's index": damage_byte("volume.zarr/samples/c/0/0/0", -9),
        "a flipped bit of a level": damage_byte("volume.zarr/levels/1/amplitude/c/0/0/0", 5000),
        "another depth of the Zarr store": damage_byte("volume.zarr/z/c/0", 8),
        "a flipped bit of the VTI": damage_byte("volume.vti", -5000),
        "a flipped bit of the NRRD": damage_byte("volume.nrrd", -5000),
        "a flipped bit of depth.ply": damage_byte("depth.ply", -500),
        "a flipped bit of scene.ply": damage_byte("scene.ply", -37),
        "a flipped bit of mesh.ply": damage_byte("mesh.ply", -2),
        "a flipped bit of a PNG's signature": damage_byte("depth.png", 1),
        "a missing file": lambda copy: (copy / "amplitude.png").unlink(),
        "a stray file": lambda copy: (copy / "stray.txt").write_text("?"),
    }
    unnoticed = []
    for what, damage in damages.items():
        if not all((folder / name).exists() for name in ("volume.zarr", "volume.vti", "volume.nrrd", "depth.ply")):
            sys.exit(f"{folder}: --prove needs a result with a Zarr store, a VTI, a NRRD and points")
        with tempfile.TemporaryDirectory() as temporary:
            copy = Path(temporary) / "copy"
            shutil.copytree(folder, copy)
            damage(copy)
            run = subprocess.run([sys.executable, __file__, str(copy)], capture_output=True, text=True)
            noticed = [line for line in run.stdout.splitlines() if line.startswith("FAILED")]
            if run.returncode == 1 and noticed:
                print(f"noticed {what}: {noticed[0].replace(str(copy) + '/', '')}")
            else:
                unnoticed.append(what)
                print(f"NOT NOTICED: {what} (exit status {run.returncode})\n{run.stdout}{run.stderr}")
    print(f"{len(damages) - len(unnoticed)} passed, {len(unnoticed)} failed")
    sys.exit(1 if unnoticed else 0)


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    if sys.argv[1] == "--prove":
        prove(Path(sys.argv[2]))
    for folder in sys.argv[1:]:
        before = passed, len(failed)
        try:
            check_folder(folder)
        except Exception as error:  # a reader that gives up has noticed something, too
            check(folder, "every file can be read", False, f"({type(error).__name__}: {error})")
        print(f"{folder}: {passed - before[0]} checks passed, {len(failed) - before[1]} failed")
    if tensorstore is None:
        print("(tensorstore is not installed: the Zarr stores were read by zarr-python and xarray alone)")
    if vtkXMLImageDataReader is None:
        print("(VTK is not installed: the VTI was read by hand alone)")
    print(f"{passed} passed, {len(failed)} failed")
    sys.exit(1 if failed or not passed else 0)


if __name__ == "__main__":
    main()
