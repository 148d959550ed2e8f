"""The part "walk" of a cell: a flight off the path of a capture, what flickers on it, and the holes."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import is_installed
from msb.bench.aggregate import CONDITION_TITLES
from msb.bench.folder import WALK_FILM
from msb.bench.photographs import checked_scene
from msb.bench.quality import open_renderer
from msb.bench.records import WalkDocument
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

# Frames, evenly spread, whose surfaces are looked for in all others.
_LOOKS = 8
# In a film, levels of change are shown so many times as bright.
_LOUDER = 16


class _Moment(NamedTuple):
    """What is measured of a frame between its neighbours, and its picture beside what flickers, as bytes."""

    squares: float
    counted: int
    holes: int
    shown: int
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]]


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
    squares, counted, missing, shown = 0.0, 0, 0, 0
    worst, worst_frame, film = 0.0, 0, list[_Moment]()
    recent: deque[_Moment] = deque(maxlen=min(PACE, len(cameras) - 2))
    with open_renderer(job) as renderer:
        for number, moment in enumerate(_moments(renderer, cameras, scene)):
            squares, counted = squares + moment.squares, counted + moment.counted
            missing, shown = missing + moment.holes, shown + moment.shown
            recent.append(moment)
            if len(recent) == recent.maxlen and (not film or _flicker(recent) > worst):
                worst, worst_frame, film = _flicker(recent), number + 2 - len(recent), list(recent)
    if not counted:
        text = "no frame of the walk shows depths of the model that can be followed into the next ones"
        raise Unsupported("UNSUPPORTED_TIER", text)
    if filmed := is_installed("av"):
        title = CONDITION_TITLES.get(job.cell.condition_name, job.cell.condition_name)
        titles = [title, f"Flicker, {_LOUDER} times"]
        write_film(job.folder / WALK_FILM, (labelled(one.pictures, titles) for one in film), PACE)
    document = WalkDocument(
        frames=len(cameras),
        width=cameras[0].width,
        height=cameras[0].height,
        flicker=math.sqrt(squares / counted),
        flicker_worst=worst,
        worst_frame=worst_frame,
        holes=missing / max(1, shown),
        film=WALK_FILM if filmed else None,
        seconds=time.perf_counter() - start,
    )
    return {"walk": document}


def _flicker(moments: Iterable[_Moment]) -> float:
    squares, counted = zip(*((one.squares, one.counted) for one in moments), strict=True)
    return math.sqrt(sum(squares) / max(1, sum(counted)))


def _moments(renderer: Renderer, cameras: Sequence[Camera], scene: Scene) -> Iterator[_Moment]:
    """Yield every frame of a walk but the first and the last, measured."""
    spread = [cameras[k * len(cameras) // _LOOKS] for k in range(min(_LOOKS, len(cameras)))]
    points = np.concatenate([surface_points(one) for one, _ in _drawn(renderer, spread, scene)])
    frames = _drawn(renderer, cameras, scene)
    (before, _), (here, picture) = next(frames), next(frames)
    for after, later in frames:
        change = unexplained_change(before, here, after)
        hole = holes(here, points)
        louder = to_bytes(np.nan_to_num(change) * (_LOUDER / 255))
        yield _Moment(
            float(np.nansum(np.square(change, dtype=np.float64))),
            int(np.isfinite(change).sum()),
            int(hole.sum()),
            int((hole | here.covered).sum()),
            (picture, louder[..., None].repeat(3, axis=2)),
        )
        before, here, picture = here, after, later


def _drawn(
    renderer: Renderer, cameras: Sequence[Camera], scene: Scene
) -> Iterator[tuple[Still, NDArray[np.uint8]]]:
    """Yield frames made ready to be measured, and their pictures as bytes."""
    for camera in cameras:
        frame = renderer.render(camera, scene.background)
        yield still(camera, frame.image, frame.alpha, frame.depth), to_bytes(frame.image)
