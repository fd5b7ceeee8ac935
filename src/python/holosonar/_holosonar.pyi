"""The extension module, in Rust: plain data in and out. The classes of the package wrap it."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

_Progress = Callable[[str, int, int], object] | None
_Triple = tuple[float, float, float]
_AxisTuple = tuple[float, float, int]

__version__: str

class CubeParts(TypedDict):
    samples: NDArray[Any]
    provenance: str | None
    frequencies: NDArray[np.float64]
    mic_positions: NDArray[np.float64]
    sound_speed: float
    geometry: Literal["fixed-source", "monostatic", "pair"]
    source: _Triple
    sources: NDArray[np.float64] | None
    detection: Literal["quadrature", "in-phase"]

class VolumeParts(TypedDict):
    samples: NDArray[np.complex64]
    x: _AxisTuple
    y: _AxisTuple
    z: _AxisTuple
    meta: str

class LayerParts(TypedDict):
    depth: NDArray[np.float32]
    amplitude: NDArray[np.float32]
    confidence: NDArray[np.float32] | None
    error: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None
    facing: NDArray[np.float32] | None
    material: NDArray[np.uint32] | None

class DepthParts(TypedDict):
    view: Literal["orthographic", "perspective"]
    x: _AxisTuple
    y: _AxisTuple
    picked: LayerParts
    returns: list[LayerParts]
    materials: list[str]
    meta: str

class ImageParts(TypedDict):
    volume: VolumeParts
    depth: DepthParts
    truth: DepthParts | None
    report: str
    files: list[PathLike[str]]

class RunFile:
    @staticmethod
    def load(path: str, settings: list[str]) -> RunFile: ...
    @staticmethod
    def from_toml(text: str, folder: str, settings: list[str]) -> RunFile: ...
    def with_settings(self, settings: list[str]) -> RunFile: ...
    def to_toml(self) -> str: ...
    def to_json(self) -> str: ...
    @property
    def path(self) -> PathLike[str] | None: ...
    @property
    def has_scene(self) -> bool: ...
    @property
    def hints(self) -> list[str]: ...

def run_command(arguments: Sequence[str]) -> int: ...
def users_secret() -> bytes: ...
def stepped_frequencies(start: float, stop: float, step: float) -> NDArray[np.float64]: ...
def rectangular_array(
    count: tuple[int, int], pitch: tuple[float, float], centre: _Triple
) -> NDArray[np.float64]: ...
def spiral_array(count: int, extent: tuple[float, float], centre: _Triple) -> NDArray[np.float64]: ...
def random_array(
    count: int, extent: tuple[float, float], centre: _Triple, spacing: float | None, seed: int
) -> NDArray[np.float64]: ...
def read_array(path: str) -> NDArray[np.float64]: ...
def advised_pitch(instrument: Any, nearest_z: float) -> list[float]: ...
def simulate_points(
    positions: NDArray[np.float64],
    amplitudes: NDArray[np.complex64],
    instrument: Any,
    run: RunFile,
    progress: _Progress,
) -> NDArray[Any]: ...
def simulate_scene(run: RunFile, memory: str | None, progress: _Progress) -> CubeParts: ...
def read_cube(path: str) -> CubeParts: ...
def write_cube(path: str, samples: NDArray[Any], instrument: Any, provenance: str | None) -> None: ...
def read_reflectors(path: str) -> tuple[NDArray[np.float64], NDArray[np.complex64]]: ...
def reconstruct(
    samples: NDArray[Any], instrument: Any, grid: Any, run: RunFile, memory: str | None, progress: _Progress
) -> VolumeParts: ...
def read_volume(path: str) -> VolumeParts: ...
def write_volume(
    path: str, samples: NDArray[np.complex64], grid: Any, meta: str, run: RunFile
) -> list[PathLike[str]]: ...
def locate_depth(
    samples: NDArray[np.complex64], grid: Any, meta: str, run: RunFile, sweep_known: bool, progress: _Progress
) -> DepthParts: ...
def truth(run: RunFile, progress: _Progress) -> DepthParts: ...
def read_depth(path: str) -> DepthParts: ...
def write_depth(path: str, map: Any, meta: str, run: RunFile) -> None: ...
def compare(found: Any, truth: Any, meta: tuple[str, str], resolution: float | None) -> str: ...
def image_scene(run: RunFile, output: str | None, memory: str | None, progress: _Progress) -> ImageParts: ...
def image_file(
    path: str, run: RunFile, output: str | None, memory: str | None, progress: _Progress
) -> ImageParts: ...
def image_samples(
    samples: NDArray[Any],
    instrument: Any,
    grid: Any,
    run: RunFile,
    output: str | None,
    memory: str | None,
    progress: _Progress,
) -> ImageParts: ...
def plan(run: RunFile, cube: str | None, memory: str | None) -> tuple[str, str]: ...
def plan_sweep(
    run: RunFile, keys: list[tuple[str, list[str]]], memory: str | None, progress: _Progress
) -> str: ...
def simulate_sweep(
    run: RunFile,
    keys: list[tuple[str, list[str]]],
    seeds: list[int],
    measure: str,
    output: str | None,
    memory: str | None,
    progress: _Progress,
) -> str: ...
def psf(run: RunFile, points: list[list[float]], progress: _Progress) -> tuple[str, bytes]: ...
def amplitude_picture(samples: NDArray[np.complex64], grid: Any) -> bytes: ...
def depth_picture(map: Any, truth: bool) -> bytes: ...
def error_picture(found: Any, truth: Any, resolution: float, note: str) -> bytes: ...
