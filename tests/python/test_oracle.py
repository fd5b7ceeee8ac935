"""Simulation and reconstruction against sums written out in NumPy, in double precision."""

import warnings

import numpy as np
import pytest

import holosonar


def paths(points, instrument):
    """Path lengths from the loudspeaker by way of each point to each microphone, (points, microphones), m."""
    mics = instrument.mic_positions.reshape(-1, 3)
    back = np.linalg.norm(points[:, None] - mics, axis=-1)
    if instrument.geometry == "monostatic":
        return 2.0 * back
    return np.linalg.norm(points - np.array(instrument.source), axis=-1)[:, None] + back


def phasors(points, instrument):
    """exp(+i 2 pi f path / c), (points, frequencies, microphones)."""
    cycles = instrument.frequencies[:, None] * paths(points, instrument)[:, None] / instrument.sound_speed
    return np.exp(2j * np.pi * cycles)


def literal_cube(reflectors, instrument):
    sums = np.einsum("p,pfr->fr", reflectors.amplitudes.astype(complex), phasors(reflectors.positions, instrument))
    return (sums.real if instrument.detection == "in-phase" else sums).reshape(instrument.shape)


def literal_volume(cube, grid):
    z, y, x = np.meshgrid(grid.z.positions, grid.y.positions, grid.x.positions, indexing="ij")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    samples = cube.samples.reshape(len(cube.instrument.frequencies), -1).astype(complex)
    weight = 2.0 if cube.instrument.detection == "in-phase" else 1.0
    sums = np.einsum("fr,pfr->p", samples, phasors(points, cube.instrument).conj())
    return weight * sums.reshape(grid.shape) / samples.size


def variants(instrument):
    parts = (instrument.frequencies, instrument.mic_positions, instrument.sound_speed)
    yield instrument
    yield holosonar.Instrument(*parts, geometry="monostatic")
    yield holosonar.Instrument(*parts, source=(0.3, -0.1, 0.05))
    yield holosonar.Instrument(*parts, detection="in-phase")


@pytest.mark.parametrize("which", ["instrument", "scattered"])
@pytest.mark.parametrize("variant", range(4))
def test_a_cube_is_the_sum_over_its_reflectors(which, variant, reflectors, request):
    instrument = list(variants(request.getfixturevalue(which)))[variant]
    cube = holosonar.simulate(reflectors, instrument)
    expected = literal_cube(reflectors, instrument)
    assert cube.shape == instrument.shape == expected.shape
    assert cube.samples.dtype == (np.float32 if instrument.detection == "in-phase" else np.complex64)
    assert np.abs(cube.samples - expected).max() < 1e-5 * np.abs(reflectors.amplitudes).sum()


@pytest.mark.parametrize("which", ["instrument", "scattered"])
@pytest.mark.parametrize("variant", range(4))
@pytest.mark.parametrize("method", ["auto", "direct", "backprojection", "convolution"])
def test_a_volume_is_the_sum_over_its_cube(which, variant, method, grid, request):
    instrument = list(variants(request.getfixturevalue(which)))[variant]
    random = np.random.default_rng(variant)
    samples = random.normal(size=instrument.shape)
    if instrument.detection == "quadrature":
        samples = samples + 1j * random.normal(size=instrument.shape)
    with pytest.warns(holosonar.PrecisionWarning):
        cube = holosonar.Cube(samples, instrument)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", holosonar.HolosonarWarning)
        volume = holosonar.reconstruct(cube, grid, method=method, window="none", tolerance=1e-5)
    expected = literal_volume(cube, grid)
    assert volume.samples.dtype == np.complex64 and volume.samples.shape == grid.shape
    assert np.abs(volume.samples - expected).max() < 3e-5 * np.abs(samples).mean()


def test_a_unit_reflector_on_a_voxel_peaks_at_one(instrument, grid):
    cube = holosonar.simulate(holosonar.Reflectors([(0.03, -0.06, 0.8)]), instrument)
    volume = holosonar.reconstruct(cube, grid)
    assert np.unravel_index(volume.amplitude.argmax(), grid.shape) == (5, 2, 6)
    assert abs(volume.samples[5, 2, 6] - 1) < 1e-2


def test_noise_is_seeded_and_as_strong_as_asked_for(instrument, reflectors):
    silent = holosonar.simulate(reflectors, instrument).samples
    noisy = [holosonar.simulate(reflectors, instrument, snr_db=20, seed=seed).samples for seed in (1, 1, 2)]
    assert np.array_equal(noisy[0], noisy[1]) and not np.array_equal(noisy[0], noisy[2])
    power = [np.mean(np.abs(samples) ** 2) for samples in (silent, noisy[0] - silent)]
    assert 10 * np.log10(power[0] / power[1]) == pytest.approx(20, abs=0.5)


SOURCES = [(0.3, -0.1, 0.05), (-0.2, 0.0, 0.0), (0.0, 0.25, -0.05)]


@pytest.mark.parametrize("which", ["instrument", "scattered"])
def test_several_loudspeakers_are_the_mean_of_each(which, reflectors, grid, request, tmp_path):
    one = request.getfixturevalue(which)
    parts = (one.frequencies, one.mic_positions, one.sound_speed)
    instrument = holosonar.Instrument(*parts, sources=SOURCES)
    assert instrument.speakers == 3 and "3 loudspeakers" in repr(instrument)
    cube = holosonar.simulate(reflectors, instrument)
    assert cube.shape == instrument.shape == (3, *one.shape)
    volumes = []
    for samples, source in zip(cube.samples, SOURCES, strict=True):
        alone = holosonar.Instrument(*parts, source=source)
        assert np.abs(samples - holosonar.simulate(reflectors, alone).samples).max() < 1e-6
        volumes.append(literal_volume(holosonar.Cube(samples, alone), grid))
    expected = np.mean(volumes, axis=0)
    found = holosonar.reconstruct(cube, grid, method="direct").samples
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()
    # Flat lists of microphones, and the way through a file.
    flat = holosonar.Cube(cube.samples.reshape(3, len(one.frequencies), -1), instrument)
    assert flat.shape == cube.shape
    cube.write(tmp_path / "several.npz")
    read = holosonar.read_cube(tmp_path / "several.npz")
    assert np.array_equal(read.samples, cube.samples) and np.array_equal(read.instrument.sources, SOURCES)
    with pytest.raises(holosonar.InputError, match="samples"):
        holosonar.Cube(cube.samples[:2], instrument)


def test_pairs_have_a_loudspeaker_for_each_microphone(scattered, reflectors, grid, tmp_path):
    parts = (scattered.frequencies, scattered.mic_positions, scattered.sound_speed)
    sources = np.random.default_rng(5).uniform(-0.2, 0.2, scattered.mic_positions.shape)
    instrument = holosonar.Instrument(*parts, geometry="pair", sources=sources)
    cube = holosonar.simulate(reflectors, instrument)
    assert cube.shape == scattered.shape
    for r, source in enumerate(sources):
        alone = holosonar.Instrument(parts[0], parts[1][r : r + 1], parts[2], source=tuple(source))
        assert np.abs(cube.samples[:, r] - literal_cube(reflectors, alone)[:, 0]).max() < 1e-4
    holosonar.reconstruct(cube, grid)
    cube.write(tmp_path / "pairs.npz")
    read = holosonar.read_cube(tmp_path / "pairs.npz")
    assert read.instrument.geometry == "pair" and np.allclose(read.instrument.sources, sources, atol=1e-12)
    with pytest.raises(holosonar.InputError, match="sources"):
        holosonar.Instrument(*parts, geometry="pair")
    with pytest.raises(holosonar.InputError, match="sources"):
        holosonar.Instrument(*parts, geometry="monostatic", sources=sources)
