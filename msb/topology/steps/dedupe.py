"""Remove every face that repeats an earlier face."""

from typing import Any

from numpy.typing import NDArray

from msb.topology.faces import find_duplicate_faces
from msb.topology.steps.change import Change, with_faces


def dedupe(faces: NDArray[Any], vertex_count: int) -> Change:
    """Keep only the first of all faces with the same three vertices in any order."""
    return with_faces(faces, ~find_duplicate_faces(faces), vertex_count)
