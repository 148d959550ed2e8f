"""The part "walk" of a cell: a flight off the path of a capture, what flickers on it, and the holes."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import is_installed
from msb.bench.aggregate import CONDITION_TITLES
from msb.bench.documents import WalkDocument
from msb.bench.folder import WALK_FILM
from msb.bench.photographs import checked_scene
from msb.bench.quality import open_renderer
from msb.bench.videos import labelled
from msb.errors import Unsupported
from msb.metrics.steadiness import Still, holes, still, surface_points, unexplained_change
from msb.render.images import to_bytes, write_film
from msb.scenes.walk import PACE, walk

if TYPE_CHECKING:
    from msb.bench.job import Job
    from msb.bench.protocol_tables import WalkTable
    from msb.render import Renderer
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

_LOOKS = 8
"""Frames, evenly spread, whose surfaces are looked for in all others."""
_LOUDER = 16
"""In a film, levels of change are shown so many times as bright."""


def flight(scene: Scene, wanted: WalkTable) -> list[Camera]:
    """Return the cameras of a scene's walk, past its test views and off all of its views."""
    every = (*scene.train, *scene.test)
    return walk(scene.test, every, wanted.frames, wanted.reach, wanted.size)


def measure_walk(job: Job) -> dict[str, Any]:
    """Return how steady a cell's condition is on the walk.

    The cell's folder gets a film of the second that flickers most, if the extra `video` is installed.
    """
    assert job.walk is not None
    start = time.perf_counter()
    scene = checked_scene(job.scene, job.views)
    cameras = flight(scene, job.walk)
    with open_renderer(job) as renderer:
        spread = [cameras[k * len(cameras) // _LOOKS] for k in range(min(_LOOKS, len(cameras)))]
        looks = [surface_points(one) for one in _stills(renderer, spread, scene)]
        points = np.concatenate(looks)
        missing, shown = 0, 0
        squares, counts = np.zeros((2, len(cameras) - 2))
        for number, (before, here, after) in enumerate(_threes(_stills(renderer, cameras, scene))):
            change = unexplained_change(before, here, after)
            counts[number] = np.isfinite(change).sum()
            squares[number] = np.nansum(np.square(change, dtype=np.float64))
            hole = holes(here, points)
            missing += int(hole.sum())
            shown += int((hole | here.covered).sum())
        if not counts.any():
            text = "no frame of the walk shows depths of the model that can be followed into the next ones"
            raise Unsupported("UNSUPPORTED_TIER", text)
        first, worst = _worst_second(squares, counts)
        film = is_installed("av")
        if film:
            second = cameras[first : first + min(PACE, len(squares)) + 2]
            title = CONDITION_TITLES.get(job.cell.condition_name, job.cell.condition_name)
            write_film(job.folder / WALK_FILM, _film(renderer, second, scene, title), PACE)
    document = WalkDocument(
        frames=len(cameras),
        width=cameras[0].width,
        height=cameras[0].height,
        flicker=math.sqrt(squares.sum() / counts.sum()),
        flicker_worst=worst,
        worst_frame=first + 1,
        holes=missing / max(1, shown),
        film=WALK_FILM if film else None,
        seconds=time.perf_counter() - start,
    )
    return {"walk": document}


def _stills(renderer: Renderer, cameras: Sequence[Camera], scene: Scene) -> Iterator[Still]:
    for camera in cameras:
        frame = renderer.render(camera, scene.background)
        yield still(camera, frame.image, frame.alpha, frame.depth)


def _threes(stills: Iterator[Still]) -> Iterator[tuple[Still, Still, Still]]:
    """Yield every frame but the first and the last, between its neighbours."""
    before, here = next(stills), next(stills)
    for after in stills:
        yield before, here, after
        before, here = here, after


def _worst_second(squares: NDArray[np.float64], counts: NDArray[np.float64]) -> tuple[int, float]:
    """Return where the second that flickers most begins, and how much it does."""
    window = np.ones(min(PACE, len(squares)))
    total, pixels = (np.convolve(values, window, "valid") for values in (squares, counts))
    means = np.sqrt(total / np.maximum(pixels, 1))
    first = int(means.argmax())
    return first, float(means[first])


def _film(
    renderer: Renderer, cameras: Sequence[Camera], scene: Scene, title: str
) -> Iterator[NDArray[np.float32]]:
    """Yield the frames between the first and the last of `cameras`, each beside what flickers in it."""
    pictures = []

    def drawn() -> Iterator[Still]:
        for camera in cameras:
            frame = renderer.render(camera, scene.background)
            pictures.append(to_bytes(frame.image))
            yield still(camera, frame.image, frame.alpha, frame.depth)

    for number, three in enumerate(_threes(drawn())):
        louder = np.nan_to_num(unexplained_change(*three)) * (_LOUDER / 255)
        grey = to_bytes(louder)[..., None].repeat(3, axis=2)
        yield labelled([pictures[number + 1], grey], [title, f"Flicker, {_LOUDER} times"])
