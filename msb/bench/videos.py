"""Films of a method's conditions side by side, along a flight or through the test views."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb import metrics
from msb.base.atomic import new_file
from msb.bench.aggregate import CONDITION_TITLES
from msb.bench.checked import read_json
from msb.bench.digest import digest
from msb.bench.folder import Results, check_run
from msb.bench.photographs import checked_scene
from msb.bench.quality import open_renderer
from msb.errors import MsbError
from msb.render.images import image_names, to_bytes, write_film
from msb.scenes import Camera, interpolated

if TYPE_CHECKING:
    from msb.bench.job import Job
    from msb.bench.protocol_tables import VideosTable

SCHEMA = "msb.video/1"
PHOTOGRAPH = "photograph"
_LABEL = 1 / 20
"""Height of a title, as a share of the image's height."""
_SMALLEST = 240
"""The least height of a film in pixels; in smaller images each pixel is enlarged to a square."""


@dataclass(frozen=True)
class VideoTask:
    """The order to make one film of a method on a scene."""

    jobs: tuple[Job, ...]
    """Those of the conditions shown, in the order shown."""
    options: VideosTable
    inputs: str
    """The hash of all inputs that decide the film."""

    @property
    def name(self) -> str:
        """What progress shows."""
        cell = self.jobs[0].cell
        return " ".join(cell.names[:3])

    @property
    def path(self) -> Path:
        """The film's."""
        return Results(self.jobs[0].root).video(*self.jobs[0].cell.names[:3])


def video_tasks(options: VideosTable, jobs: Sequence[Job]) -> list[VideoTask]:
    """Return the films to be made: those of finished cells that have no film, or an outdated one.

    A flight shows what can be rendered; official renderings and photographs exist at the test views only.
    """
    groups: dict[tuple[str, ...], list[Job]] = {}
    for job in jobs:
        shown = job.cell.condition in ("dedicated", "standard")
        if shown or (job.cell.condition == "non_engine" and options.path == "test"):
            groups.setdefault(job.cell.names[:3], []).append(job)
    tasks = []
    for group in groups.values():
        held: list[tuple[Job, Any]] = []
        for job in group:
            with contextlib.suppress(MsbError):
                result = Results(job.root).read(job.cell)
                if result.status == "done":
                    held.append((job, result.inputs["quality"]))
        if held:
            inputs = digest(
                [options.model_dump(), [(job.cell.condition_name, inputs) for job, inputs in held]]
            )
            task = VideoTask(tuple(job for job, _ in held), options, inputs)
            if not _is_done(task):
                tasks.append(task)
    return tasks


def _is_done(task: VideoTask) -> bool:
    try:
        about = read_json(task.path.with_suffix(".json"), 1 << 16)
    except MsbError:
        return False
    return isinstance(about, dict) and about.get("inputs") == task.inputs and task.path.exists()


def write_video(task: VideoTask) -> None:
    """Render and write a film, and beside it a file that says what it shows."""
    first = task.jobs[0]
    check_run(first.root, first.run)
    scene = checked_scene(first.scene, first.views)
    titles = [CONDITION_TITLES.get(job.cell.condition_name, job.cell.condition_name) for job in task.jobs]
    with contextlib.ExitStack() as stack:
        if task.options.path == "test":
            titles = [PHOTOGRAPH.capitalize(), *titles]
            frames = _held(task, image_names(scene.test))
        else:
            cameras = interpolated(scene.test, task.options.frames)
            frames = _flight(task, cameras, scene.background, stack)
        write_film(task.path, (labelled(row, titles) for row in frames), task.options.fps)
    about = {
        "schema": SCHEMA,
        "inputs": task.inputs,
        "columns": titles,
        "path": task.options.path,
        "frames": task.options.frames,
        "fps": task.options.fps,
    }
    with new_file(task.path.with_suffix(".json")) as file:
        file.write(json.dumps(about, indent=1).encode() + b"\n")


def _flight(
    task: VideoTask,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    stack: contextlib.ExitStack,
) -> Iterator[list[NDArray[Any]]]:
    renderers = [stack.enter_context(open_renderer(job)) for job in task.jobs]
    for camera in cameras:
        yield [to_bytes(renderer.render(camera, background).image) for renderer in renderers]


def _held(task: VideoTask, names: Sequence[str]) -> Iterator[list[NDArray[Any]]]:
    """Yield the test views as they are on disk, each for the same time."""
    folders = [task.jobs[0].photographs, *(job.folder / "images" for job in task.jobs)]
    last, row = None, []
    for frame in range(task.options.frames):
        name = names[frame * len(names) // task.options.frames]
        if name != last:
            last, row = name, [metrics.read_image(folder / f"{name}.png") for folder in folders]
        yield row


def labelled(images: Sequence[NDArray[Any]], titles: Sequence[str]) -> NDArray[np.float32]:
    """Return images of one size, (H, W, 3) uint8, side by side with a title in the corner of each."""
    from PIL import Image, ImageDraw, ImageFont

    times = -(-_SMALLEST // images[0].shape[0])
    pixels = np.concatenate(images, axis=1).repeat(times, axis=0).repeat(times, axis=1)
    height, width = pixels.shape[0], pixels.shape[1] // len(images)
    picture = Image.fromarray(pixels)
    draw = ImageDraw.Draw(picture)
    size = round(height * _LABEL)
    font = ImageFont.load_default(size)
    for number, title in enumerate(titles):
        place = (number * width + size // 2, size // 2)
        draw.text(place, title, (255, 255, 255), font, stroke_width=size // 10, stroke_fill=(0, 0, 0))
    return np.asarray(picture, np.float32) / np.float32(255)
