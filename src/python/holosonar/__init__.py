"""holosonar images 3-D scenes with sound: a loudspeaker, a planar microphone array, stepped tones.

A scene is simulated into a data cube, or a measured one is taken; the cube is reconstructed into a volume, and depth is
located in it:

>>> import holosonar
>>> instrument = holosonar.Instrument(
...     holosonar.stepped_frequencies(10e3, 20e3, 100.0), holosonar.rectangular_array((31, 31), 0.03)
... )
>>> cube = holosonar.simulate(holosonar.Reflectors([(0.1, -0.05, 1.0)]), instrument)
>>> grid = holosonar.Grid.spanning(x=(-0.3, 0.3), y=(-0.3, 0.3), z=(0.9, 1.1), pitch=(0.015, 0.015, 0.008))
>>> volume = holosonar.reconstruct(cube, grid)
>>> depth = holosonar.locate_depth(volume)

Arrays are ``[frequency, y, x]`` (cubes), ``[z, y, x]`` (volumes) and ``[y, x]`` (maps), SI units, x to the right, y down, z
from the array into the scene. ``holosonar.image("scenes/corner.toml")`` does all of it from a run file, and the command
``holosonar`` is installed, too. ``holosonar.io`` reads measurements of MATLAB, Acoular, USTB, SOFA and Touchstone. The guide's
chapter on Python has more.
"""

from . import io
from ._cubes import (
    Cube,
    Instrument,
    Reflectors,
    random_array,
    read_array,
    read_cube,
    rectangular_array,
    simulate,
    spiral_array,
    stepped_frequencies,
)
from ._depths import DepthLayer, DepthMap, Scores, compare, error_picture, locate_depth, read_depth, truth
from ._errors import (
    HolosonarError,
    HolosonarWarning,
    InputError,
    Interrupted,
    LimitMissedError,
    MemoryLimitError,
    NotFoundError,
    OutOfMemoryError,
    PrecisionWarning,
    SystemFailure,
)
from ._holosonar import __version__
from ._images import Image, Plan, PointSpreads, image, plan, plan_sweep, psf
from ._progress import Progress, ProgressCallback
from ._run_file import RunFile, Settings
from ._volumes import Axis, Grid, Volume, read_volume, reconstruct

__all__ = [
    "Axis",
    "Cube",
    "DepthLayer",
    "DepthMap",
    "Grid",
    "HolosonarError",
    "HolosonarWarning",
    "Image",
    "InputError",
    "Instrument",
    "Interrupted",
    "LimitMissedError",
    "MemoryLimitError",
    "NotFoundError",
    "OutOfMemoryError",
    "Plan",
    "PointSpreads",
    "PrecisionWarning",
    "Progress",
    "ProgressCallback",
    "Reflectors",
    "RunFile",
    "Scores",
    "Settings",
    "SystemFailure",
    "Volume",
    "__version__",
    "compare",
    "error_picture",
    "image",
    "io",
    "locate_depth",
    "plan",
    "plan_sweep",
    "psf",
    "random_array",
    "read_array",
    "read_cube",
    "read_depth",
    "read_volume",
    "reconstruct",
    "rectangular_array",
    "simulate",
    "spiral_array",
    "stepped_frequencies",
    "truth",
]
