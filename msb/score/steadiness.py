"""Shimmer and popping of an asset on a walk between and beyond the photographs of a capture."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.metrics.steadiness import prepare_frame, unexplained_change
from msb.render.standard.renderer import StandardRenderer
from msb.scenes.datasets import Scene
from msb.scenes.walk import make_walk
from msb.score.pose import GREY

# The walk of `msb run`: distance of its stops from the cameras in radii of the capture, and longer side of
# its frames in pixels.
_REACH, _SIZE = 0.25, 640
# Levels of 255 above which a change between frames is a pop and not shimmer.
_POP = 16.0


@dataclass(frozen=True)
class Steadiness:
    """Changes between frames that the camera's motion does not explain.

    Attributes
    ----------
    frames : int
    shimmer : float
        Root mean square over all pixels of all frames, in levels of 255.
    popping : float
        Share of the pixels that change by more than 16 levels.
    worst_frame : int
        The frame with the largest root mean square.
    """

    frames: int
    shimmer: float
    popping: float
    worst_frame: int

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON data."""
        return dict(vars(self))


def measure_steadiness(
    asset: Asset, scene: Scene, frames: int, device: str | None, step: Callable[[], None]
) -> Steadiness | None:
    """Return shimmer and popping on a walk of at least three frames.

    None if no surface point stays in view.
    """
    cameras = make_walk(scene.test, (*scene.train, *scene.test), frames, _REACH, _SIZE)
    squares, popped, counts = [], 0, []
    with contextlib.closing(StandardRenderer(asset, device=device)) as renderer:
        window: list[Any] = []
        for camera in cameras:
            frame = renderer.render(camera.in_units(asset.manifest.origin), GREY)
            window = [
                *window[-2:],
                prepare_frame(camera, frame.image, frame.alpha, frame.depth * camera.unit),
            ]
            step()
            if len(window) < 3:
                continue
            change = unexplained_change(*window)
            change = change[np.isfinite(change)].astype(np.float64)
            squares.append(float(np.square(change).sum()))
            counts.append(len(change))
            popped += int((change > _POP).sum())
    total = sum(counts)
    if not total:
        return None
    worst = int(np.argmax([square / max(1, count) for square, count in zip(squares, counts, strict=True)]))
    return Steadiness(len(cameras), math.sqrt(sum(squares) / total), popped / total, worst + 1)
