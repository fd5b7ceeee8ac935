"""Measurements in the formats of the field, read into a :class:`holosonar.Cube`.

Every reader ends in a cube whose phase grows along a path, m = sum of A exp(+i 2 pi f path / c), as the whole program has it.
A Fourier transform of a recording and the S21 of a network analyser have the opposite sign, and are conjugated. Positions are
in m, x to the right, y down, z from the array into the scene; microphones that fill a raster become rows and columns, for
which reconstruction is fastest.

Libraries that read the files are imported when they are needed: ``pip install 'holosonar[io]'`` brings all of them.
"""

from ._acoular import read_acoular
from ._matlab import read_matlab
from ._responses import from_impulse_responses
from ._sofa import read_sofa
from ._touchstone import read_touchstone
from ._uff import read_uff

__all__ = ["from_impulse_responses", "read_acoular", "read_matlab", "read_sofa", "read_touchstone", "read_uff"]
