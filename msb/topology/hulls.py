"""Convex hulls of collision shapes: the limit of corners, and the directions to seek corners in."""

import numpy as np
from numpy.typing import NDArray

# Most corners of a hull. It then has at most 252 faces, and physics engines take 255 of either.
HULL_CORNERS = 128


def hull_directions(count: int) -> NDArray[np.float64]:
    """Return the axes and, evenly over the sphere on a spiral, further directions: (count, 3)."""
    turn = np.arange(count - 6) + 0.5
    height = 1 - 2 * turn / (count - 6)
    angle, radius = np.pi * (3 - np.sqrt(5)) * turn, np.sqrt(1 - height**2)
    spiral = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    return np.concatenate([np.eye(3), -np.eye(3), spiral])
