#!/usr/bin/env python3
"""Writes the files of tests/data/reference: cubes and volumes by brute force, from the equations and nothing of ours.

    generate.py OUTDIR             writes all of them there
    generate.py --check FOLDER     makes them anew in a temporary folder and compares FOLDER with them, value by value
    generate.py --prove FOLDER     damages copies of FOLDER, one value or file each, and sees that --check names the damage

Needs Python 3 and NumPy. Every sum is literal, term by term in float64: no FFT, no symmetry, no shared factors. Equation
numbers are those of L. Streeter et al., "Design of a Pseudo-Holographic Distributed Time-of-Flight Sonar Range-Imaging
System", as in src/lib.rs; where its print is off, the line says so.

Conventions: SI units, the array in z = 0, the speaker in the origin, arrays as [frequency, y, x] and [z, y, x].

* path length      fixed source |p| + |p - r|; monostatic 2|p - r|; linear 2|p| - p.r/|p|, its first-order term in r
* cube             m(f, r) = sum over reflectors of A exp(+i 2 pi f path / c)                         (Eq. 5)
                   in phase: the real part of that
* volume           w/(n_f n_r) sum over f, r of m(f, r) exp(-i 2 pi f path / c), at p                  (Eq. 13)
                   w = 1 in quadrature and 2 in phase, so that one unit reflector peaks at 1 in both

What --check allows. Positions, frequencies, axes and `meta` must be equal to the last bit. A sample is computed in float64
and stored in float32: two machines may differ by 1 unit in the last place of the float32, 2^-23 of the number, where the
float64 before rounding lies on the border of two; and by what the float64 itself errs. A phase of 2 pi f path / c <= 2000
radians errs by some 2^-52 x 2000 = 5e-13 radians, and so does every term of a sum by 5e-13 of itself; the sum of the terms'
magnitudes is at most 40 x the largest sample here, which makes 2e-11 of the largest; 1e-10 is allowed. So each real and
imaginary part may be off by 2^-23 of itself + 1e-10 of the largest sample of its file, and no more.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SOUND_SPEED = 343.0
SEED = 20261120


def uniform(random, low, high, count):
    """Numbers of equal chance in [low, high): the top 53 bits of each 64 that PCG64 gives, a stream that NumPy keeps."""
    return low + (high - low) * ((random.random_raw(count) >> np.uint64(11)) * 2.0**-53)


def reflectors(random, count, x, y, z, amplitude):
    """Positions [count, 3] in m and amplitudes [count], drawn in this order: all x, all y, all z, all amplitudes."""
    columns = [uniform(random, low, high, count) for low, high in (x, y, z, amplitude)]
    return np.stack(columns[:3], axis=1), columns[3]


def array(half_x, n_x, half_y, n_y):
    """Microphones of a lattice around the origin, [n_y, n_x, 3] in m."""
    positions = np.zeros((n_y, n_x, 3))
    positions[..., 0] = np.linspace(-half_x, half_x, n_x)
    positions[..., 1] = np.linspace(-half_y, half_y, n_y)[:, np.newaxis]
    return positions


def path_length(points, microphones, geometry):
    """Path lengths [points, microphones] in m."""
    outward = np.linalg.norm(points, axis=1)[:, np.newaxis]
    back = np.linalg.norm(points[:, np.newaxis] - microphones[np.newaxis], axis=2)
    if geometry == "fixed-source":
        return outward + back
    if geometry == "monostatic":
        return 2.0 * back
    # Eq. 8 and 9 expand |p - r| as |p| - p.r/|p| + ...; the print of Eq. 9 has the other sign before the second term.
    assert geometry == "linear"
    return 2.0 * outward - points @ microphones.T / outward


def phasors(frequency, paths, sign):
    return np.exp(sign * 2j * np.pi * frequency * paths / SOUND_SPEED)


def simulate(scene, frequencies, microphones, geometry):
    """m(f, r) in quadrature, complex128 [n_f, n_y, n_x]."""
    points, amplitudes = scene
    paths = path_length(points, microphones.reshape(-1, 3), geometry)
    samples = [(amplitudes[:, np.newaxis] * phasors(f, paths, +1)).sum(axis=0) for f in frequencies]
    return np.stack(samples).reshape(len(frequencies), *microphones.shape[:2])


def reconstruct(samples, frequencies, microphones, axes, weight):
    """The volume of a cube from a fixed source, complex128 [n_z, n_y, n_x]."""
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    paths = path_length(points, microphones.reshape(-1, 3), "fixed-source")
    volume = np.zeros(len(points), dtype=complex)
    for frequency, heard in zip(frequencies, samples.reshape(len(frequencies), -1)):
        volume += phasors(frequency, paths, -1) @ heard
    return weight * volume.reshape(x.shape) / samples.size


def write_cube(path, samples, frequencies, microphones, geometry, detection):
    """A data cube as the program reads it; float32 samples in phase, complex64 in quadrature."""
    if detection == "in-phase":
        samples = samples.real
    meta = (
        f'{{"format": "holosonar-cube", "version": 1, "sound_speed": {SOUND_SPEED}, "geometry": "{geometry}", '
        f'"detection": "{detection}", "phase_sign": 1, "source": [0.0, 0.0, 0.0]}}'
    )
    np.savez(
        path,
        samples=samples.astype(np.float32 if detection == "in-phase" else np.complex64),
        frequencies=frequencies,
        mic_positions=microphones,
        meta=np.frombuffer(meta.encode(), dtype=np.uint8),
    )


def write_csv(path, scene):
    """Reflectors with 17 digits, which give back every float64."""
    rows = np.column_stack(scene)
    lines = ["x,y,z,amplitude"] + [",".join(f"{value:.17g}" for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")


def centred(pitch, count):
    return (np.arange(count) - (count - 1) / 2) * pitch


def generate(folder):
    """All files, from one seeded stream of numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.PCG64(SEED)

    # Forward: 40 reflectors before a coarse array, with every model of propagation.
    scene = reflectors(random, 40, x=(-0.6, 0.6), y=(-0.5, 0.5), z=(0.8, 2.6), amplitude=(0.1, 1.0))
    write_csv(folder / "reflectors.csv", scene)
    frequencies, microphones = 18_000.0 + 50.0 * np.arange(41), array(0.2, 9, 0.15, 7)
    exact = simulate(scene, frequencies, microphones, "fixed-source")
    scan = simulate(scene, frequencies, microphones, "monostatic")
    linear = simulate(scene, frequencies, microphones, "linear")
    for name, samples, geometry, detection in [
        ("forward_quadrature", exact, "fixed-source", "quadrature"),
        ("forward_in_phase", exact, "fixed-source", "in-phase"),
        ("forward_monostatic_quadrature", scan, "monostatic", "quadrature"),
        ("forward_linear_in_phase", linear, "fixed-source", "in-phase"),
    ]:
        write_cube(folder / f"{name}.npz", samples, frequencies, microphones, geometry, detection)

    # Inverse: 12 reflectors close before a dense array, and volumes with voxels between its microphones (8 mm, an even
    # number of voxels) and at half its pitch (4 mm), on three depths that are no lattice's.
    scene = reflectors(random, 12, x=(-0.08, 0.08), y=(-0.06, 0.06), z=(0.5, 0.8), amplitude=(0.3, 1.0))
    frequencies, microphones = 10_000.0 + 200.0 * np.arange(51), array(0.048, 13, 0.04, 11)
    heard = simulate(scene, frequencies, microphones, "fixed-source")
    depths = np.array([0.52, 0.61, 0.7])
    grids = {
        "8mm": (centred(0.008, 20), centred(0.008, 16), depths),
        "4mm": (centred(0.004, 33), centred(0.004, 27), depths),
    }
    for detection, samples, weight in [("quadrature", heard, 1.0), ("in-phase", heard.real, 2.0)]:
        name = detection.replace("-", "_")
        write_cube(folder / f"cube_{name}.npz", heard, frequencies, microphones, "fixed-source", detection)
        for pitch, axes in grids.items():
            # Of the float64 cube, not of the float32 one in the file: that errs by less than 2^-24 of a sample.
            volume = reconstruct(samples, frequencies, microphones, axes, weight)
            np.savez(
                folder / f"volume_{name}_{pitch}.npz", samples=volume.astype(np.complex64), x=axes[0], y=axes[1], z=axes[2]
            )


def parts(values):
    """Real and imaginary parts as float64, one after the other in the last axis."""
    values = np.asarray(values)
    wide = values.astype(np.complex128 if np.iscomplexobj(values) else np.float64)
    return np.ascontiguousarray(wide).reshape(-1).view(np.float64)


def difference_of_arrays(name, expected, found):
    """What is wrong with an array, in words; None when nothing is."""
    if (expected.dtype, expected.shape) != (found.dtype, found.shape):
        return f"is {found.dtype} {list(found.shape)}, expected {expected.dtype} {list(expected.shape)}"
    if name != "samples":
        bad = np.flatnonzero(expected.reshape(-1) != found.reshape(-1))
        if len(bad):
            at = np.unravel_index(bad[0], expected.shape)
            values = f"{found[at].item()!r}, expected {expected[at].item()!r}"
            return f"{list(map(int, at))} is {values}; {len(bad)} of {expected.size} differ"
        return None
    ours, theirs = parts(expected), parts(found)
    allowed = 2.0**-23 * np.abs(ours) + 1e-10 * np.abs(expected).max()
    bad = np.flatnonzero(~(np.abs(theirs - ours) <= allowed))
    if not len(bad):
        return None
    per_sample = len(ours) // expected.size
    at = np.unravel_index(bad[0] // per_sample, expected.shape)
    off = np.abs(theirs - ours)[bad[0]] / allowed[bad[0]]
    return (
        f"{list(map(int, at))} is {found[at]}, expected {expected[at]}: {off:.3g} times what rounding allows; "
        f"{len(bad)} of {len(ours)} numbers differ"
    )


def differences_of_files(expected, found):
    """Every difference of a file from the newly generated one, one line each."""
    if expected.suffix != ".npz":
        if expected.read_bytes() != found.read_bytes():
            pairs = zip(expected.read_text().splitlines(), found.read_text(errors="replace").splitlines())
            line = next((i for i, (ours, theirs) in enumerate(pairs, 1) if ours != theirs), "its end")
            yield f"line {line}: differs"
        return
    try:
        with np.load(expected) as ours, np.load(found) as theirs:
            for name in sorted(set(ours) | set(theirs)):
                if name not in ours or name not in theirs:
                    yield f"array `{name}`: is {'missing' if name in ours else 'not expected'}"
                else:
                    problem = difference_of_arrays(name, ours[name], theirs[name])
                    if problem:
                        yield f"array `{name}`: {problem}"
    except Exception as error:  # whatever a damaged file makes of NumPy's reader
        yield f"cannot be read: {type(error).__name__}: {error}"


def differences_of_folders(made, folder):
    """Every difference of a folder from a newly generated one, one line each, and how many of its files are identical."""
    lines, equal = [], 0
    for name in sorted({path.name for path in made.iterdir()} | {path.name for path in folder.iterdir()}):
        expected, found = made / name, folder / name
        if not found.exists():
            lines.append(f"{name}: is missing")
        elif not expected.exists():
            lines.append(f"{name}: is not one that is made here")
        else:
            lines += [f"{name}: {problem}" for problem in differences_of_files(expected, found)]
            equal += expected.read_bytes() == found.read_bytes()
    return lines, equal


def check(folder):
    """Compares a folder with a newly generated one, prints every difference by name and returns their number."""
    with tempfile.TemporaryDirectory() as temporary:
        made = Path(temporary)
        generate(made)
        lines, equal = differences_of_folders(made, folder)
        count = len(list(made.iterdir()))
    for line in lines:
        print(f"FAILED {line}")
    print(f"{folder}: {count} files generated again, of which {equal} are identical; {len(lines)} differences")
    return len(lines)


def prove(folder):
    """Damages a copy of a folder in several ways; each must be named, or the check is worth nothing."""

    def change(file, array_name, alter):
        def damage(copy):
            with np.load(copy / file) as arrays:
                arrays = dict(arrays)
            alter(arrays[array_name])
            np.savez(copy / file, **arrays)

        return damage

    def add(amount, at):
        def alter(values):
            values[at] += amount

        return alter

    def three_units_in_the_last_place(values):
        values[1, 2, 3] = values[1, 2, 3].real * np.float32(1.0 + 3.0 * 2.0**-23) + 1j * values[1, 2, 3].imag

    def nan(values):
        values[0, 0, 0] = np.nan

    def replace(file, old, new):
        def damage(copy):
            text = (copy / file).read_text()
            assert old in text
            (copy / file).write_text(text.replace(old, new, 1))

        return damage

    def cut(copy):
        path = copy / "cube_in_phase.npz"
        path.write_bytes(path.read_bytes()[:-100])

    # The damage, and what must be named.
    damages = {
        "a sample off by 3 units in its last place": (
            change("volume_quadrature_8mm.npz", "samples", three_units_in_the_last_place),
            "volume_quadrature_8mm.npz: array `samples`: [1, 2, 3]",
        ),
        "a sample that is no number": (
            change("forward_in_phase.npz", "samples", nan),
            "forward_in_phase.npz: array `samples`: [0, 0, 0]",
        ),
        "a microphone 1e-17 m away": (
            change("cube_quadrature.npz", "mic_positions", add(1e-17, (4, 5, 0))),
            "cube_quadrature.npz: array `mic_positions`: [4, 5, 0]",
        ),
        "another frequency": (
            change("forward_quadrature.npz", "frequencies", add(1e-9, 7)),
            "forward_quadrature.npz: array `frequencies`: [7]",
        ),
        "another character of meta": (
            change("cube_in_phase.npz", "meta", add(1, 9)),
            "cube_in_phase.npz: array `meta`: [9]",
        ),
        "another reflector": (replace("reflectors.csv", "0.9492", "0.9493"), "reflectors.csv: line 7"),
        "a file cut short": (cut, "cube_in_phase.npz: cannot be read"),
        "a missing file": (
            lambda copy: (copy / "volume_in_phase_4mm.npz").unlink(),
            "volume_in_phase_4mm.npz: is missing",
        ),
        "a stray file": (lambda copy: (copy / "more.npz").write_bytes(b"?"), "more.npz: is not one"),
    }
    failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        made = Path(temporary) / "made"
        generate(made)
        for number, (what, (damage, named)) in enumerate(damages.items()):
            copy = Path(temporary) / f"copy{number}"
            shutil.copytree(folder, copy)
            damage(copy)
            lines, _ = differences_of_folders(made, copy)
            if len(lines) == 1 and lines[0].startswith(named):
                print(f"noticed {what}: {lines[0]}")
            else:
                failed += 1
                print(f"NOT NOTICED: {what}: {lines}")
        # And the command that does it all fails, too.
        run = subprocess.run([sys.executable, __file__, "--check", str(copy)], capture_output=True, text=True)
        if run.returncode != 1 or "FAILED" not in run.stdout:
            failed += 1
            print(f"--check ends with {run.returncode} on a damaged folder\n{run.stdout}{run.stderr}")
    print(f"{len(damages) + 1 - failed} passed, {failed} failed")
    return failed


def main():
    if len(sys.argv) == 2 and not sys.argv[1].startswith("-"):
        generate(Path(sys.argv[1]))
    elif len(sys.argv) == 3 and sys.argv[1] == "--check":
        sys.exit(1 if check(Path(sys.argv[2])) else 0)
    elif len(sys.argv) == 3 and sys.argv[1] == "--prove":
        sys.exit(1 if prove(Path(sys.argv[2])) else 0)
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main()
