"""Where SOFA's receivers and emitters are: about listener and source, in Cartesian or spherical coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._errors import InputError
from .._run_file import PathLike
from ._files import attribute_text, numbers, refusal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# Rows: x, y and z of the array, to the right, down and ahead, in SOFA's axes ahead, left and up.
_AHEAD = ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0))


def places(
    root: Any, path: PathLike, n_measurements: int, n_receivers: int, frame: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions of microphones and emitters, m, shapes (M, R, 3) and (M, E, 3), in the axes that ``frame`` says."""
    import numpy as np

    if frame not in ("sofa", "array"):
        raise InputError(f"frame: \"sofa\" or \"array\" was expected, not {frame!r}")
    n_emitters = 1
    if "EmitterPosition" in root:
        n_emitters = len(np.atleast_1d(numbers(root, "EmitterPosition", path, "where emitters are")))
    found = []
    for holder, part, count in (("Listener", "Receiver", n_receivers), ("Source", "Emitter", n_emitters)):
        centre = _about(root, path, f"{holder}Position", n_measurements)
        if f"{part}Position" in root:
            offsets = _each(root, path, f"{part}Position", count, n_measurements)
        else:
            offsets = np.zeros((n_measurements, count, 3))
        if offsets.any():
            offsets = np.einsum("mij,mej->mei", _axes(root, path, holder, n_measurements), offsets)
        found.append(centre[:, None] + offsets)
    if frame == "sofa":
        found = [points @ np.array(_AHEAD).T for points in found]
    return found[0], found[1]


def _axes(root: Any, path: PathLike, holder: str, count: int) -> NDArray[np.float64]:
    """The axes of a listener or source as columns, shape (M, 3, 3): its view, its left and its up."""
    import numpy as np

    if f"{holder}View" not in root:
        return np.broadcast_to(np.eye(3), (count, 3, 3))
    view = _about(root, path, f"{holder}View", count)
    up = _about(root, path, f"{holder}Up", count) if f"{holder}Up" in root else np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
    left = np.cross(up, view)
    length = np.linalg.norm(left, axis=1, keepdims=True)
    if (length < 1e-9).any():
        raise refusal(path, f"`{holder}View`: is along `{holder}Up`, or 0")
    left, view = left / length, view / np.linalg.norm(view, axis=1, keepdims=True)
    return np.stack([view, left, np.cross(view, left)], axis=-1)


def _about(root: Any, path: PathLike, name: str, count: int) -> NDArray[np.float64]:
    """A variable of the shape [1 or M, 3], for each measurement, Cartesian."""
    import numpy as np

    values = numbers(root, name, path, "[1 or M, 3]")
    if values.shape not in ((1, 3), (count, 3)):
        raise refusal(path, f"`{name}`: has the shape {list(values.shape)}; [1 or {count}, 3] was expected")
    unit_of = name.replace("Up", "View") if f"{name.replace('Up', 'View')}" in root else name
    return np.broadcast_to(_cartesian(path, name, values, root[unit_of]), (count, 3))


def _each(root: Any, path: PathLike, name: str, n_parts: int, count: int) -> NDArray[np.float64]:
    """A variable of the shape [R, 3], or [R, 3, 1 or M], as [M, R, 3], Cartesian."""
    import numpy as np

    held = numbers(root, name, path, "[R, 3]")
    values = held[..., None] if held.ndim == 2 else held
    if values.ndim != 3 or values.shape[:2] != (n_parts, 3) or values.shape[2] not in (1, count):
        wanted = f"[{n_parts}, 3] or [{n_parts}, 3, {count}] was expected"
        raise refusal(path, f"`{name}`: has the shape {list(held.shape)}; {wanted}")
    moved = _cartesian(path, name, np.moveaxis(values, 2, 0), root[name])
    return np.broadcast_to(moved, (count, n_parts, 3))


def _cartesian(path: PathLike, name: str, values: NDArray[np.float64], holder: Any) -> NDArray[np.float64]:
    """Coordinates along the last axis in m, by the variable's Type and Units."""
    import numpy as np

    kind = attribute_text(holder, "Type").lower() or "cartesian"
    default = "degree, degree, metre" if kind == "spherical" else "metre"
    units = [unit.strip() for unit in (attribute_text(holder, "Units").lower() or default).split(",")]
    units = units * 3 if len(units) == 1 else units
    metres, angles = {"metre", "meter", "metres", "meters", "m"}, {"degree": np.pi / 180, "degrees": np.pi / 180, "radian": 1.0}
    if kind == "cartesian" and len(units) == 3 and set(units) <= metres:
        return values
    if kind == "spherical" and len(units) == 3 and units[0] in angles and units[1] in angles and units[2] in metres:
        azimuth, elevation, radius = values[..., 0] * angles[units[0]], values[..., 1] * angles[units[1]], values[..., 2]
        across = radius * np.cos(elevation)
        return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), radius * np.sin(elevation)], axis=-1)
    wanted = "cartesian in metre, or spherical in degree, degree, metre was expected"
    raise refusal(path, f"`{name}`: {wanted}, not {kind} in {', '.join(units)}")
