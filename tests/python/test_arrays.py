"""Arrays: taken and given without copies, whatever their strides, types and byte order."""

import numpy as np
import pytest

import holosonar


def same(cube, expected, grid):
    assert np.array_equal(cube.samples, expected.samples)
    assert np.array_equal(holosonar.reconstruct(cube, grid).samples, holosonar.reconstruct(expected, grid).samples)


@pytest.fixture
def cube(instrument, reflectors):
    return holosonar.simulate(reflectors, instrument)


def test_contiguous_arrays_are_not_copied(cube, grid):
    assert np.shares_memory(holosonar.Cube(cube.samples, cube.instrument).samples, cube.samples)
    volume = holosonar.reconstruct(cube, grid)
    assert np.shares_memory(holosonar.Volume(volume.samples, grid).samples, volume.samples)
    flat = cube.samples.reshape(len(cube.samples), -1)
    assert np.shares_memory(holosonar.Cube(flat, cube.instrument).samples, cube.samples)
    frequencies = cube.instrument.frequencies
    again = holosonar.Instrument(frequencies, cube.instrument.mic_positions)
    assert np.shares_memory(again.frequencies, frequencies)


def test_results_are_writable_arrays_of_their_own(cube, grid):
    volume = holosonar.reconstruct(cube, grid)
    assert volume.samples.flags.c_contiguous and volume.samples.flags.writeable
    first = volume.samples.copy()
    volume.samples[...] = 0
    assert np.array_equal(holosonar.reconstruct(cube, grid).samples, first)


def test_a_large_cube_takes_no_second_one(grid):
    """Peak memory while 256 MB of samples are reconstructed on a few voxels."""
    resource = pytest.importorskip("resource")
    instrument = holosonar.Instrument(
        holosonar.stepped_frequencies(10e3, 20e3, 20.0), holosonar.rectangular_array((250, 250), 0.01)
    )
    samples = np.full(instrument.shape, 1, np.complex64)
    cube = holosonar.Cube(samples, instrument)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    few = holosonar.Grid.spanning(x=(0, 0.05), y=(0, 0.05), z=(1, 1.05), pitch=0.01)
    holosonar.reconstruct(cube, few)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert grown < samples.nbytes / 2, f"{grown / 2**20:.0f} MiB"


def test_any_strides_and_byte_order(cube, grid):
    samples, instrument = cube.samples, cube.instrument
    wide = np.zeros((*samples.shape[:-1], 2 * samples.shape[-1]), np.complex64)
    wide[..., ::2] = samples
    for strange in (
        np.asfortranarray(samples),
        wide[..., ::2],
        np.ascontiguousarray(samples[::-1])[::-1],
        samples.astype(">c8"),
    ):
        same(holosonar.Cube(strange, instrument), cube, grid)
    readonly = samples.copy()
    readonly.flags.writeable = False
    same(holosonar.Cube(readonly, instrument), cube, grid)


def test_double_precision_is_converted_and_said(cube, grid):
    with pytest.warns(holosonar.PrecisionWarning, match="complex128 is converted to complex64") as said:
        converted = holosonar.Cube(cube.samples.astype(complex), cube.instrument)
    assert said[0].filename == __file__
    same(converted, cube, grid)
    volume = holosonar.reconstruct(cube, grid)
    with pytest.warns(holosonar.PrecisionWarning, match="complex128"):
        holosonar.Volume(volume.samples.astype(complex), grid)


def test_what_is_no_number_is_refused(instrument):
    for samples in (np.full(instrument.shape, "a"), np.full(instrument.shape, None)):
        with pytest.raises(holosonar.InputError, match="samples: numbers were expected"):
            holosonar.Cube(samples, instrument)


def test_the_other_sign_of_the_phase(cube, grid):
    same(holosonar.Cube(cube.samples.conj(), cube.instrument, phase_sign=-1), cube, grid)


def test_rows_and_columns_that_are_no_lattice(instrument, reflectors):
    positions = instrument.mic_positions.copy()
    positions[2, 3, 0] += 0.004
    bent = holosonar.Instrument(instrument.frequencies, positions)
    cube = holosonar.simulate(reflectors, bent)
    assert cube.shape == bent.shape
    few = holosonar.Grid.spanning(x=(-0.1, 0.1), y=(0, 0), z=(0.8, 0.9), pitch=0.02)
    by_list = holosonar.Instrument(instrument.frequencies, positions.reshape(-1, 3))
    flat = holosonar.Cube(cube.samples.reshape(len(cube.samples), -1), by_list)
    assert np.array_equal(holosonar.reconstruct(cube, few).samples, holosonar.reconstruct(flat, few).samples)
