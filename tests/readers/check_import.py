#!/usr/bin/env python3
"""Writes a simulated cube as laboratories' own programs would, has it imported, and compares cubes and volumes.

    check_import.py BINARY FOLDER

FOLDER is made, and must not hold anything yet. Touchstone files are written by scikit-rf in its three forms, arrays by
NumPy in several types and orders.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import skrf

SWEEP = ["sweep.start=10000", "sweep.stop=14000", "sweep.step=100"]
ARRAY = ["array.count=[9,7]", "array.pitch=0.03"]
GRID = ["grid.x=[-0.15,0.15]", "grid.y=[-0.12,0.12]", "grid.z=[0.7,0.9]", "grid.pitch=[0.03,0.03,0.02]"]


def run(binary, folder, words, settings):
    options = [part for setting in settings for part in ("--set", setting)]
    ran = subprocess.run([binary, *words, "-q", *options], cwd=folder, capture_output=True, text=True)
    if ran.returncode:
        sys.exit(f"{' '.join(words)} {settings}: status {ran.returncode}\n{ran.stderr}")


def touchstone(folder, form, samples, frequencies, mics):
    """One file a position, named after it in mm. Along a path the phase of S21 falls: ours grows."""
    folder.mkdir()
    frequency = skrf.Frequency.from_f(frequencies, unit="hz")
    for (iy, ix), m in zip(np.ndindex(mics.shape[:2]), samples.reshape(len(frequencies), -1).T.conj()):
        s = np.full((len(frequencies), 2, 2), 0.1, complex)
        s[:, 1, 0] = m
        x, y = (1000 * mics[iy, ix, :2]).round().astype(int)
        skrf.Network(frequency=frequency, s=s).write_touchstone(f"x{x}_y{y}", dir=str(folder), form=form)


def main():
    binary, folder = str(Path(sys.argv[1]).resolve()), Path(sys.argv[2])
    folder.mkdir()
    (folder / "points.csv").write_text("x,y,z,amplitude\n0.02,-0.05,0.8,1\n-0.07,0.04,0.76,0.7\n")
    run(binary, folder, ["simulate", "points.csv", "-o", "cube.npz"], SWEEP + ARRAY)
    run(binary, folder, ["reconstruct", "cube.npz", "-o", "volume.npz"], GRID)
    with np.load(folder / "cube.npz") as cube, np.load(folder / "volume.npz") as volume:
        samples, frequencies, mics = cube["samples"], cube["frequencies"], cube["mic_positions"]
        image = volume["samples"]

    cases = []
    for form in ("ri", "ma", "db"):
        touchstone(folder / form, form, samples, frequencies, mics)
        cases.append((f"Touchstone, {form}", f"{form}/x{{x}}_y{{y}}.s2p", ["import.name_unit=mm"], 1e-6))
    by_f = SWEEP + ARRAY + ["import.phase_sign=1"]
    np.save(folder / "big_endian.npy", samples.transpose(2, 1, 0).astype(">c16"))
    cases.append(("NumPy, [x, y, f] big-endian", "big_endian.npy", [*by_f, 'import.axes=["x","y","f"]'], 1e-6))
    np.save(folder / "fortran.npy", np.asfortranarray(samples.conj()))
    conjugate = [*by_f[:-1], "import.phase_sign=-1", 'import.axes=["f","y","x"]']
    cases.append(("NumPy, Fortran order, the other sign", "fortran.npy", conjugate, 1e-6))
    scale = 30000 / np.abs(samples).max()
    raw = {"i": samples.real, "q": samples.imag}
    raw = {name: (32768 + scale * values).round().astype(np.uint16) for name, values in raw.items()}
    np.savez_compressed(folder / "raw.npz", f=frequencies, mics=mics, **raw)
    converter = ['import.arrays=["i","q"]', 'import.axes=["f","y","x"]', "import.offset=32768", "import.phase_sign=1"]
    converter += ["import.frequencies=f", "import.positions=mics"]
    cases.append(("NumPy, 16 bits of I and Q", "raw.npz", converter, 1e-4))

    for number, (name, source, settings, bound) in enumerate(cases):
        imported, seen = f"imported{number}.npz", f"volume{number}.npz"
        run(binary, folder, ["import", source, "-o", imported], settings)
        run(binary, folder, ["reconstruct", imported, "-o", seen], GRID)
        with np.load(folder / imported) as cube, np.load(folder / seen) as volume:
            factor = scale if source == "raw.npz" else 1.0
            errors = [
                np.abs(cube["samples"] / factor - samples).max() / np.abs(samples).max(),
                np.abs(volume["samples"] / factor - image).max() / np.abs(image).max(),
                np.abs(cube["mic_positions"] - mics).max(),
            ]
            assert np.allclose(cube["frequencies"], frequencies, rtol=1e-12), name
        print(f"{name}: cube {errors[0]:.1e}, volume {errors[1]:.1e}, positions {errors[2]:.1e} m")
        if errors[0] > bound or errors[1] > bound or errors[2] > 1e-9:
            sys.exit(f"{name}: an error above {bound}")
    print(f"{len(cases)} ways to write a cube, read back.")


if __name__ == "__main__":
    main()
