"""The kinds of collision shapes, as options name them. Nothing here imports NumPy."""

from typing import Literal

from msb.errors import UsageError, shorten

CollisionKind = Literal["mesh", "hulls", "box"]

# Faces of the smallest closed mesh, a tetrahedron.
MIN_CLOSED_FACES = 4
# Largest number of faces or convex parts of a collision shape. The limit catches typing mistakes.
_MAX_COLLISION_SIZE = 1 << 20


def parse_collision(text: str) -> tuple[CollisionKind, int]:
    """Return the kind and the largest number of faces or parts in "mesh:1000", "hulls:16" or "box".

    Raises
    ------
    UsageError
        USAGE: the text is invalid.
    """
    name, _, number = text.partition(":")
    if text == "box":
        return "box", 1
    count = int(number) if number.isascii() and number.isdigit() and len(number) < 9 else 0
    if name == "mesh" and MIN_CLOSED_FACES <= count <= _MAX_COLLISION_SIZE:
        return "mesh", count
    if name == "hulls" and 1 <= count <= _MAX_COLLISION_SIZE:
        return "hulls", count
    expected = f"mesh:N (N faces, {MIN_CLOSED_FACES} or more), hulls:N (N convex parts) or box"
    raise UsageError("USAGE", f'--collision is "{shorten(text, 40)}"; it must be {expected}')
