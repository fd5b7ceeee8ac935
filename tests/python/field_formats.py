"""A small measurement, and what a laboratory would record of it, for the tests of the readers of other formats."""

import numpy as np

import holosonar

ECHO = (0.06, -0.04, 0.8)  # m
SOUND_SPEED = 343.0
RATE = 48_000.0
SAMPLES = 480  # so that the sweep's step of 100 Hz is the transform's
TONES = holosonar.stepped_frequencies(10e3, 14e3, 100.0)
MICROPHONES = holosonar.rectangular_array((9, 7), 0.04)
GRID = holosonar.Grid.spanning(x=(-0.15, 0.15), y=(-0.12, 0.12), z=(0.6, 1.0), pitch=(0.03, 0.04, 0.02))


def measured(source=(0.0, 0.0, 0.0), microphones=MICROPHONES, geometry="fixed-source", reflectors=None):
    """The cube of one reflector at ECHO, or of those that are given."""
    instrument = holosonar.Instrument(TONES, microphones, SOUND_SPEED, geometry, source)
    return holosonar.simulate(reflectors or holosonar.Reflectors([ECHO]), instrument)


def responses_of(cube):
    """Real impulse responses [n_mic, SAMPLES] whose transform, at the tones, is the conjugate of the cube."""
    spectrum = np.zeros((SAMPLES // 2 + 1, cube.samples[0].size), complex)
    spectrum[np.round(TONES * SAMPLES / RATE).astype(int)] = cube.samples.reshape(len(TONES), -1).conj()
    return np.fft.irfft(spectrum, SAMPLES, axis=0).T


def echo_at(paths, rate, samples, start=0.0):
    """Echoes after paths in m, [n_mic, samples]: pulses that are limited to the band, sampled from `start` s on."""
    late = (np.asarray(paths) / SOUND_SPEED - start) * rate
    return np.sinc(np.arange(samples) - late[:, None])


def error(cube, expected):
    """The largest difference of samples, relative to the largest sample."""
    assert cube.shape == expected.shape, (cube.shape, expected.shape)
    assert np.allclose(cube.instrument.frequencies, expected.instrument.frequencies, rtol=1e-9)
    assert np.allclose(cube.instrument.mic_positions, expected.instrument.mic_positions, atol=1e-7)
    assert np.allclose(cube.instrument.source, expected.instrument.source, atol=1e-7)
    assert cube.instrument.geometry == expected.instrument.geometry
    return np.abs(cube.samples - expected.samples).max() / np.abs(expected.samples).max()


def peak(cube):
    """Where the image is brightest, m, and how bright."""
    volume = holosonar.reconstruct(cube, GRID)
    z, y, x = np.unravel_index(volume.amplitude.argmax(), GRID.shape)
    return (GRID.x.positions[x], GRID.y.positions[y], GRID.z.positions[z]), float(volume.amplitude.max())


def shows_the_echo(cube, amplitude=1.0):
    """Whether the image has the reflector at its place; it has not if the sign of the phase is wrong."""
    at, bright = peak(cube)
    right = np.allclose(at, ECHO, atol=1e-9) and bright > 0.9 * amplitude
    turned = holosonar.Cube(cube.samples, cube.instrument, phase_sign=-1)
    _, dim = peak(turned)
    assert dim < 0.5 * bright, f"the other sign is {dim / bright:.2f} as bright"
    return right
