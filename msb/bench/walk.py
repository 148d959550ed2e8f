"""The part "walk" of a benchmark cell: flicker and holes on a camera path away from the captured views."""

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
from msb.bench.photographs import read_planned_scene
from msb.bench.quality import open_renderer
from msb.bench.records import WalkDocument
from msb.bench.videos import label_images
from msb.errors import Unsupported
from msb.metrics.steadiness import (
    PreparedFrame,
    find_holes,
    find_surface_points,
    prepare_frame,
    unexplained_change,
)
from msb.render.images import to_bytes, write_film
from msb.scenes.walk import PACE, make_walk

if TYPE_CHECKING:
    from msb.bench.job import Job
    from msb.bench.protocol_tables import WalkTable
    from msb.render import Renderer
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

# Number of frames that supply surface points. These frames are evenly spread over the camera path. A pixel is
# a hole if its frame shows background in place of a surface point of another frame.
_SURFACE_FRAMES = 8
# Brightness factor for the changes in the video, which would be invisible without this factor.
_CHANGE_GAIN = 16


class _FrameChange(NamedTuple):
    """The changes in one frame, compared with the previous and the next frame."""

    # Sum of the squared changes of pixel values in squared levels, and the number of compared pixels.
    squares: float
    counted: int
    # The number of pixels in holes, and the number of pixels that show the model or a hole.
    holes: int
    visible: int
    # The image and its magnified changes, both (H, W, 3) uint8.
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]]


def plan_walk(scene: Scene, table: WalkTable) -> list[Camera]:
    """Return the cameras of a path (walk) near the test views, but away from all captured views."""
    views = (*scene.train, *scene.test)
    return make_walk(scene.test, views, table.frames, table.reach, table.size)


def measure_walk(job: Job) -> dict[str, Any]:
    """Return flicker and holes of a benchmark cell on its camera path.

    With the extra `video`, a video of the second with the most flicker is written to the folder of the
    benchmark cell.
    """
    assert job.walk is not None
    start = time.perf_counter()
    scene = read_planned_scene(job.scene, job.views)
    cameras = plan_walk(scene, job.walk)
    squares, counted, missing, visible = 0.0, 0, 0, 0
    worst, worst_frame, film = 0.0, 0, list[_FrameChange]()
    # The frames of the second before the current frame. The video shows the second with the most flicker.
    recent: deque[_FrameChange] = deque(maxlen=min(PACE, len(cameras) - 2))
    with open_renderer(job) as renderer:
        for number, change in enumerate(_measure_frames(renderer, cameras, scene)):
            squares, counted = squares + change.squares, counted + change.counted
            missing, visible = missing + change.holes, visible + change.visible
            recent.append(change)
            if len(recent) == recent.maxlen and (not film or _compute_flicker(recent) > worst):
                worst, worst_frame, film = _compute_flicker(recent), number + 2 - len(recent), list(recent)
    if not counted:
        text = (
            "flicker cannot be measured, because no surface point is visible in successive frames of the walk"
        )
        raise Unsupported("UNSUPPORTED_TIER", text)
    if filmed := is_installed("av"):
        title = CONDITION_TITLES.get(job.cell.condition_name, job.cell.condition_name)
        titles = [title, f"Flicker x {_CHANGE_GAIN}"]
        write_film(job.folder / WALK_FILM, (label_images(change.pictures, titles) for change in film), PACE)
    document = WalkDocument(
        frames=len(cameras),
        width=cameras[0].width,
        height=cameras[0].height,
        flicker=math.sqrt(squares / counted),
        flicker_worst=worst,
        worst_frame=worst_frame,
        holes=missing / max(1, visible),
        film=WALK_FILM if filmed else None,
        seconds=time.perf_counter() - start,
    )
    return {"walk": document}


def _compute_flicker(changes: Iterable[_FrameChange]) -> float:
    """Return the root mean square of the changes in several frames, in levels of 255."""
    squares, counted = zip(*((change.squares, change.counted) for change in changes), strict=True)
    return math.sqrt(sum(squares) / max(1, sum(counted)))


def _measure_frames(renderer: Renderer, cameras: Sequence[Camera], scene: Scene) -> Iterator[_FrameChange]:
    """Yield the measurements of every frame of a camera path except the first and the last frame."""
    # Compute surface points of a few frames. If a surface point shows background in another frame, the pixel
    # is a hole.
    spread = [cameras[k * len(cameras) // _SURFACE_FRAMES] for k in range(min(_SURFACE_FRAMES, len(cameras)))]
    points = np.concatenate(
        [find_surface_points(frame) for frame, _ in _render_stills(renderer, spread, scene)]
    )
    # Compare each frame with the previous and the next frame.
    frames = _render_stills(renderer, cameras, scene)
    (before, _), (current, picture) = next(frames), next(frames)
    for after, next_picture in frames:
        change = unexplained_change(before, current, after)
        hole = find_holes(current, points)
        enlarged = to_bytes(np.nan_to_num(change) * (_CHANGE_GAIN / 255))
        yield _FrameChange(
            float(np.nansum(np.square(change, dtype=np.float64))),
            int(np.isfinite(change).sum()),
            int(hole.sum()),
            int((hole | current.covered).sum()),
            (picture, enlarged[..., None].repeat(3, axis=2)),
        )
        before, current, picture = current, after, next_picture


def _render_stills(
    renderer: Renderer, cameras: Sequence[Camera], scene: Scene
) -> Iterator[tuple[PreparedFrame, NDArray[np.uint8]]]:
    """Yield the image of each frame, (H, W, 3) uint8, with the depth of the frame."""
    for camera in cameras:
        frame = renderer.render(camera, scene.background)
        yield prepare_frame(camera, frame.image, frame.alpha, frame.depth), to_bytes(frame.image)
