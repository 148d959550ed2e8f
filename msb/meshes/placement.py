"""The placement of a mesh in a file: the rotation, the scale to metres, and the height above the floor.

A rotated file records the placement. Reading the file restores the coordinates of the capture, which match
the cameras of the capture.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.frame import Frame, is_axis, nearest_axis, parse_up, unit_vector
from msb.errors import MsbError
from msb.meshes.mesh import Mesh
from msb.meshes.transform import rotate_axis, rotate_upright

# These words precede the JSON of a placement in comments of text files.
MARK = "MeshSplatBench frame"
# The JSON key of the placement, in `asset.extras` of glTF and in the layer data of USD.
KEY = "frame"
_COMMENT = re.compile(rb"^(?:#|comment) " + MARK.encode() + rb" (\{[^\r\n]{1,2000}\})\r?$", re.MULTILINE)
# The comment is searched in this number of bytes at the start of a text file.
_MOST_BYTES = 1 << 14
# Largest magnitude of an entry of R R^T - I for a valid rotation matrix R.
_MAX_ERROR = 1e-6


@dataclass(frozen=True, eq=False)
class Placement:
    """This placement converts coordinates of the capture to the file: file = scale * rotation @ capture +
    offset, for column vectors.

    Attributes
    ----------
    rotation : (3, 3) float64
    scale : float
        Units of the file per unit of the capture.
    offset : (3,) float64
    up : str, optional
        The axis of the capture that points up. The value is None if the axis is unknown.
    frame : Frame, optional
        The known parts of the capture's frame.
    """

    rotation: NDArray[np.float64]
    scale: float
    offset: NDArray[np.float64]
    up: str | None
    frame: Frame | None

    def to_json(self) -> dict[str, Any]:
        """Return the placement as JSON data: the 16 numbers of the matrix by rows, and the frame."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.scale * self.rotation, self.offset
        frame = self.frame or Frame()
        return {
            "matrix": matrix.reshape(-1).tolist(),
            "up": self.up if frame.up is None else list(frame.up),
            "meters_per_unit": frame.meters_per_unit,
            "source": frame.source,
            "floor": frame.floor,
        }

    @property
    def comment(self) -> str:
        """The text of a comment line that records the placement, without the comment characters."""
        return f"{MARK} {json.dumps(self.to_json(), separators=(',', ':'))}"


def place(mesh: Mesh, *, is_upright: bool) -> Mesh:
    """Return a mesh in the form that is written to a file.

    The mesh is in metres if its unit is known. If `is_upright`, rotate the mesh so that +y is up. The
    argument `mesh` is given in the coordinates of the capture. The written mesh has a `placement` if it
    differs from `mesh`, or if a unit is recorded.
    """
    frame = mesh.frame or Frame()
    up = frame.up if frame.up is not None else (None if mesh.up is None else parse_up(mesh.up))
    rotates = is_upright and up is not None
    scale = frame.meters_per_unit or 1.0
    offset = np.zeros(3)
    if frame.floor is not None and up is not None:
        # The floor moves along the up direction of the file, which is +y if the mesh is rotated.
        offset = -scale * frame.floor * np.array((0.0, 1.0, 0.0) if rotates else up)
    if mesh.frame is None and (not rotates or mesh.up == "+y"):
        return mesh
    axis = mesh.up if up is None else nearest_axis(up)
    if rotates and up is not None:
        # If the up direction is an axis, coordinates are only swapped and negated, which is exact. For all
        # other directions, the smallest rotation is used.
        columns = rotate_axis(np.eye(3), axis or "+y") if is_axis(up) else _rotate_to_y(np.array(up)).T
        rotation = np.ascontiguousarray(columns.T)
    else:
        rotation = np.eye(3)
    placement = Placement(rotation, scale, offset, axis, mesh.frame)
    is_exact = scale == 1 and not offset.any()
    if is_exact and rotates and axis is not None and up is not None and is_axis(up):
        placed = rotate_upright(mesh, axis)
    elif is_exact and not rotates:
        placed = mesh
    else:
        vertices = mesh.vertices.astype(np.float64) @ (scale * rotation).T + offset
        placed = replace(mesh, vertices=vertices.astype(mesh.vertices.dtype))
    return replace(placed, up="+y" if rotates else axis, frame=None, placement=placement)


def _rotate_to_y(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest rotation matrix (3, 3) that maps the unit vector `up` to +y."""
    if up[1] < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    x, y, z = np.cross(up, (0.0, 1.0, 0.0))
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + up[1]))


def take_back(mesh: Mesh, data: Any) -> Mesh:
    """Return a mesh in the coordinates of the capture. The file's JSON `data` records these coordinates.

    Invalid placement data is ignored, because any program may have written it.
    """
    placement = _parse(data)
    if placement is None:
        return mesh
    rotation, scale, offset = placement.rotation, placement.scale, placement.offset
    is_swap = bool(np.isin(rotation, (-1.0, 0.0, 1.0)).all())
    if scale == 1 and not offset.any() and is_swap:
        vertices = mesh.vertices
        if (rotation != np.eye(3)).any():
            vertices = rotate_axis(vertices, "+y", placement.up or "+y")
    else:
        moved = (mesh.vertices.astype(np.float64) - offset) @ (rotation / scale)
        vertices = moved.astype(mesh.vertices.dtype)
    # The field `up` stores an up axis. The frame stores any other up direction.
    frame = placement.frame or Frame()
    frame = replace(frame, up=None) if frame.up is not None and is_axis(frame.up) else frame
    known = None if frame == Frame() else frame
    return replace(mesh, vertices=vertices, up=placement.up, frame=known, meters_per_unit=None)


def find_comment(data: bytes) -> Any:
    """Return the JSON data of the placement in the comments of a text file. Return None if there is no such
    comment."""
    match = _COMMENT.search(data[:_MOST_BYTES])
    if match is None:
        return None
    try:
        return json.loads(match[1])
    except (ValueError, RecursionError):
        return None


def _parse(data: Any) -> Placement | None:
    """Return the placement that JSON data describes. Return None if the data is invalid."""
    try:
        matrix = np.array(data["matrix"], np.float64).reshape(4, 4)
        up, unit, floor = data["up"], data["meters_per_unit"], data["floor"]
        vector = None if up is None else unit_vector(up) if isinstance(up, list) else parse_up(up)
        if vector is not None and len(vector) != 3:
            return None
        numbers = [*matrix.reshape(-1), *(value for value in (unit, floor) if value is not None)]
        if not all(math.isfinite(float(value)) for value in numbers) or (unit is not None and unit <= 0):
            return None
        frame = Frame(vector, unit, str(data["source"])[:200], floor)
    except (KeyError, TypeError, ValueError, MsbError):
        return None
    left = matrix[:3, :3]
    determinant = float(np.linalg.det(left))
    if determinant <= 0 or (matrix[3] != (0, 0, 0, 1)).any():
        return None
    scale = determinant ** (1 / 3)
    scale = 1.0 if abs(scale - 1) < _MAX_ERROR and np.isin(left, (-1.0, 0.0, 1.0)).all() else scale
    rotation = left / scale
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _MAX_ERROR:
        return None
    axis = None if vector is None else nearest_axis(vector)
    return Placement(rotation, scale, matrix[:3, 3], axis, frame)
