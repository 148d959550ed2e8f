"""Limits of the convex hulls of collision shapes, and the directions that select the hull's corners."""

import numpy as np
from numpy.typing import NDArray

# Maximum number of corners of a hull. A hull with this number of corners has at most 252 faces. Physics
# engines accept 255 corners and 255 faces.
HULL_CORNERS = 128


def hull_directions(count: int) -> NDArray[np.float64]:
    """Return `count` unit directions (count, 3): the six axes, then points spread evenly over the sphere."""
    turn = np.arange(count - 6) + 0.5
    height = 1 - 2 * turn / (count - 6)
    angle, radius = np.pi * (3 - np.sqrt(5)) * turn, np.sqrt(1 - height**2)
    spiral = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    return np.concatenate([np.eye(3), -np.eye(3), spiral])
