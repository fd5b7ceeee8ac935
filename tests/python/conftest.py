"""What the tests of the Python package share: small measurements, and the command line to compare with."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import holosonar

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def corner():
    """A run file of a small scene."""
    return REPOSITORY / "tests/data/small/corner.toml"


@pytest.fixture(scope="session")
def command():
    """Runs the command line: the binary that HOLOSONAR_BINARY names, or the package's own."""
    binary = os.environ.get("HOLOSONAR_BINARY")
    program = [binary] if binary else [sys.executable, "-m", "holosonar"]

    def run(*arguments, status=0):
        ran = subprocess.run([*program, *map(str, arguments)], capture_output=True, text=True)
        assert ran.returncode == status, ran.stderr
        return ran

    return run


@pytest.fixture
def instrument():
    return holosonar.Instrument(
        holosonar.stepped_frequencies(10e3, 14e3, 100.0), holosonar.rectangular_array((9, 7), (0.03, 0.04))
    )


@pytest.fixture
def scattered():
    positions = holosonar.random_array(40, (0.4, 0.3), (0.02, -0.03, 0.0), seed=7)
    return holosonar.Instrument(holosonar.stepped_frequencies(9e3, 12e3, 150.0), positions, 340.0)


@pytest.fixture
def grid():
    return holosonar.Grid.spanning(x=(-0.15, 0.15), y=(-0.1, 0.1), z=(0.7, 0.9), pitch=(0.03, 0.02, 0.02))


@pytest.fixture
def reflectors():
    random = np.random.default_rng(5)
    positions = random.uniform((-0.2, -0.2, 0.7), (0.2, 0.2, 1.0), (12, 3))
    amplitudes = (random.normal(size=12) + 1j * random.normal(size=12)).astype(np.complex64)
    return holosonar.Reflectors(positions, amplitudes)
