#!/usr/bin/env python3
"""Stores that zarr-python, xarray and tensorstore write are read by holosonar as the same arrays in an npz are.

    check_zarr.py HOLOSONAR OUTDIR FOLDER    OUTDIR is a result of `holosonar image` with a volume.npz

One line per check that fails, exit status 1 if there is any.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import xarray
import zarr
from checks import check, conclude

try:
    import tensorstore
except ImportError:
    tensorstore = None


def facts(program, path):
    """What `info` says of a file, or why it refuses it."""
    run = subprocess.run([program, "info", path, "--json"], capture_output=True, text=True)
    if run.returncode != 0:
        return f"exit status {run.returncode}: {run.stderr}"
    found = json.loads(run.stdout)
    # Of a store without `pitch` that is found from the ends of an axis.
    axes = {axis: {key: round(value, 12) for key, value in found[axis].items()} for axis in "xyz"}
    return found | axes


def volume_by_zarr(path, arrays, meta, **layout):
    """A group of arrays, of which `samples` and `amplitude` are stored as asked."""
    shutil.rmtree(path, ignore_errors=True)
    group = zarr.create_group(str(path), attributes={"meta": meta})
    for name, values in arrays.items():
        options = layout if values.ndim == 3 else {}
        group.create_array(name, data=values, **options)


def volume_by_xarray(path, arrays, meta, **_):
    shutil.rmtree(path, ignore_errors=True)
    data = {name: (("z", "y", "x"), values) for name, values in arrays.items() if values.ndim == 3}
    coordinates = {axis: arrays[axis] for axis in "zyx"}
    xarray.Dataset(data, coordinates, {"meta": meta}).to_zarr(path, zarr_format=3, consolidated=False)


def volume_by_tensorstore(path, arrays, meta, **_):
    volume_by_zarr(path, arrays, meta)
    for name in ("samples", "amplitude"):
        values = arrays[name]
        shutil.rmtree(path / name)
        codecs = [{"name": "bytes", "configuration": {"endian": "big"}}, {"name": "crc32c"}]
        shards = {"chunk_shape": [8, 16, 32], "codecs": codecs, "index_location": "start"}
        metadata = {
            "shape": values.shape,
            "data_type": str(values.dtype),
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [16, 64, 64]}},
            "codecs": [{"name": "sharding_indexed", "configuration": shards}],
        }
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(path / name)}, "metadata": metadata}
        tensorstore.open(spec, create=True).result().write(values).result()


def main():
    program, result, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    with np.load(result / "volume.npz") as file:
        arrays = {name: file[name] for name in file.files}
    meta = json.loads(bytes(arrays.pop("meta")).decode("utf-8"))
    samples = arrays["samples"].astype(np.complex128)
    arrays["amplitude"] = np.hypot(samples.real, samples.imag).astype(np.float32)
    expected = facts(program, result / "volume.npz")
    gzip, crc = zarr.codecs.GzipCodec(), zarr.codecs.Crc32cCodec()
    big = zarr.codecs.BytesCodec(endian="big")
    ways = {
        "zarr-python as it likes": (volume_by_zarr, {}),
        "gzip": (volume_by_zarr, {"chunks": (7, 50, 30), "compressors": [gzip]}),
        "no compression, big-endian": (volume_by_zarr, {"chunks": (40, 40, 40), "compressors": None, "serializer": big}),
        "shards of gzip": (volume_by_zarr, {"chunks": (8, 32, 32), "shards": (32, 64, 64), "compressors": [gzip]}),
        "shards of zstd": (volume_by_zarr, {"chunks": (8, 32, 32), "shards": (16, 192, 160)}),
        "gzip and crc32c": (volume_by_zarr, {"chunks": (126, 161, 145), "compressors": [gzip, crc]}),
        "names of version 2": (volume_by_zarr, {"chunk_key_encoding": {"name": "v2", "separator": "."}}),
        "xarray as it likes": (volume_by_xarray, {}),
    }
    if tensorstore is not None:
        ways["tensorstore, index at the start"] = (volume_by_tensorstore, {})
    # The volume's depth is found by its samples, and the same of both only if every one is the same.
    store = folder / "volume.zarr"
    subprocess.run([program, "depth", result / "volume.npz", "-o", folder / "npz.exr", "-q"], check=True)
    for what, (write, layout) in ways.items():
        write(store, arrays, meta, **layout)
        found = facts(program, store)
        check(f"{what}: info is that of the npz", found == expected, str(found)[:300])
        read = subprocess.run([program, "depth", store, "-o", folder / "zarr.exr", "-q"], capture_output=True, text=True)
        same = read.returncode == 0 and (folder / "zarr.exr").read_bytes() == (folder / "npz.exr").read_bytes()
        check(f"{what}: the depth map is that of the npz", same, read.stderr)

    refusals = {
        "blosc": ("blosc", {"compressors": [zarr.codecs.BloscCodec()]}),
        "transposed": ("transpose", {"filters": [zarr.codecs.TransposeCodec(order=(2, 1, 0))]}),
    }
    for what, (word, layout) in refusals.items():
        volume_by_zarr(store, arrays, meta, **layout)
        found = facts(program, store)
        check(f"{what} is refused by name", "exit status 2" in found and word in found, str(found)[:300])
    shutil.rmtree(store)
    zarr.create_group(str(store), zarr_format=2).create_array("samples", data=arrays["samples"])
    found = facts(program, store)
    check("version 2 is refused", "exit status 2" in found and "migrate" in found, str(found)[:300])
    conclude()


if __name__ == "__main__":
    main()
