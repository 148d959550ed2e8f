"""Films of a method's conditions side by side, along a flight or the test views, and of all methods."""

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
from msb.registry import METHODS
from msb.render.images import image_names, read_film, to_bytes, write_film
from msb.scenes import Camera, interpolated

if TYPE_CHECKING:
    from PIL.Image import Image

    from msb.bench.job import Job
    from msb.bench.protocol_tables import VideosTable

SCHEMA = "msb.video/1"
PHOTOGRAPH = "photograph"
# Height of a title, as a share of the image's height.
_LABEL = 1 / 20
# The least height of a film in pixels; in smaller images each pixel is enlarged to a square.
_SMALLEST = 240


@dataclass(frozen=True)
class FilmTask:
    """The order to make one film: of a method on a scene, or of all methods of a scene."""

    # Dataset and scene, and the model if the film is of one.
    names: tuple[str, ...]
    # Those of the conditions shown, in the order shown; of several methods the first of each.
    jobs: tuple[Job, ...]
    options: VideosTable
    # The hash of all inputs that decide the film.
    inputs: str

    @property
    def name(self) -> str:
        """What progress shows."""
        return " ".join(self.names)

    @property
    def path(self) -> Path:
        """The film's."""
        return Results(self.jobs[0].root).video(*self.names)

    @property
    def is_made(self) -> bool:
        """Whether the film is there and still holds."""
        return _about(self.path).get("inputs") == self.inputs


def video_tasks(options: VideosTable, jobs: Sequence[Job]) -> list[FilmTask]:
    """Return the films to be made: those of finished cells that have no film, or an outdated one.

    A flight shows what can be rendered; official renderings and photographs exist at the test views only.
    """
    groups: dict[tuple[str, ...], list[Job]] = {}
    for job in jobs:
        shown = job.cell.condition in ("dedicated", "standard")
        if shown or (job.cell.condition == "non_engine" and options.path == "test"):
            groups.setdefault(job.cell.names[:3], []).append(job)
    tasks = []
    for names, group in groups.items():
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
            tasks.append(FilmTask(names, tuple(job for job, _ in held), options, inputs))
    return [task for task in tasks if not task.is_made]


def grid_tasks(options: VideosTable, jobs: Sequence[Job]) -> list[FilmTask]:
    """Return the films of several methods to be made, of those whose own films are there."""
    scenes: dict[tuple[str, str], dict[str, Job]] = {}
    for job in jobs:
        dataset, scene, model, _ = job.cell.names
        scenes.setdefault((dataset, scene), {}).setdefault(model, job)
    tasks = []
    for names, models in scenes.items():
        inputs = {model: _about(_film(job)).get("inputs") for model, job in models.items()}
        made = tuple(job for model, job in models.items() if inputs[model] is not None)
        if len(made) > 1:
            tasks.append(FilmTask(names, made, options, digest(["grid", inputs])))
    return [task for task in tasks if not task.is_made]


def _film(job: Job) -> Path:
    """Return the film of a job's model on its scene."""
    return Results(job.root).video(*job.cell.names[:3])


def _about(film: Path) -> dict[str, Any]:
    """Return what the file beside a film says of it; nothing unless both are there."""
    with contextlib.suppress(MsbError):
        about = read_json(film.with_suffix(".json"), 1 << 16)
        if isinstance(about, dict) and film.exists():
            return about
    return {}


def write_video(task: FilmTask) -> None:
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
    _write_about(task, columns=titles)


def write_grid(task: FilmTask) -> None:
    """Write the film of a scene's methods below each other, each cut from its own film, and what it shows."""
    check_run(task.jobs[0].root, task.jobs[0].run)
    films, models = [_film(job) for job in task.jobs], [job.cell.model_name for job in task.jobs]
    shown = [_about(film)["columns"] for film in films]
    # Most first: they have the order of all.
    columns = list(
        dict.fromkeys(title for titles in sorted(shown, key=len, reverse=True) for title in titles)
    )
    rows = zip(*(_panels(film, titles) for film, titles in zip(films, shown, strict=True)), strict=False)
    titles = [METHODS[model].title if model in METHODS else model for model in models]
    write_film(task.path, (_grid(row, columns, titles) for row in rows), task.options.fps)
    _write_about(task, columns=columns, rows=models)


def _panels(film: Path, titles: Sequence[str]) -> Iterator[dict[str, NDArray[np.uint8]]]:
    """Yield title -> picture for each frame of a method's film."""
    for pixels in read_film(film):
        width = pixels.shape[1] // len(titles)
        yield {title: pixels[:, n * width : (n + 1) * width] for n, title in enumerate(titles)}


def _grid(
    rows: Sequence[dict[str, NDArray[np.uint8]]], columns: Sequence[str], titles: Sequence[str]
) -> NDArray[np.float32]:
    """Return the panels of all methods in one picture, each method's title below its first panel's own."""
    from PIL import Image

    width, height = (max(panel.shape[axis] for row in rows for panel in row.values()) for axis in (1, 0))
    picture = Image.new("RGB", (width * len(columns), height * len(rows)))
    for y, (row, name) in enumerate(zip(rows, titles, strict=True)):
        for title, panel in row.items():
            x = columns.index(title)
            picture.paste(Image.fromarray(panel).resize((width, height)), (x * width, y * height))
        _write_title(picture, name, (0, (y + 1) * height - 2 * round(height * _LABEL)), height)
    return np.asarray(picture, np.float32) / np.float32(255)


def _write_about(task: FilmTask, **shown: list[str]) -> None:
    about = {"schema": SCHEMA, "inputs": task.inputs, **shown, **task.options.model_dump()}
    with new_file(task.path.with_suffix(".json")) as file:
        file.write(json.dumps(about, indent=1).encode() + b"\n")


def _flight(
    task: FilmTask,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    stack: contextlib.ExitStack,
) -> Iterator[list[NDArray[Any]]]:
    renderers = [stack.enter_context(open_renderer(job)) for job in task.jobs]
    for camera in cameras:
        yield [to_bytes(renderer.render(camera, background).image) for renderer in renderers]


def _held(task: FilmTask, names: Sequence[str]) -> Iterator[list[NDArray[Any]]]:
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
    from PIL import Image

    times = -(-_SMALLEST // images[0].shape[0])
    pixels = np.concatenate(images, axis=1).repeat(times, axis=0).repeat(times, axis=1)
    height, width = pixels.shape[0], pixels.shape[1] // len(images)
    picture = Image.fromarray(pixels)
    for number, title in enumerate(titles):
        _write_title(picture, title, (number * width, 0), height)
    return np.asarray(picture, np.float32) / np.float32(255)


def _write_title(picture: Image, title: str, corner: tuple[int, int], height: int) -> None:
    """Write a title into a picture, below and right of a corner, as large as it is in a panel of `height`."""
    from PIL import ImageDraw, ImageFont

    size = round(height * _LABEL)
    place = (corner[0] + size // 2, corner[1] + size // 2)
    font = ImageFont.load_default(size)
    edge: dict[str, Any] = {"stroke_width": size // 10, "stroke_fill": (0, 0, 0)}
    ImageDraw.Draw(picture).text(place, title, (255, 255, 255), font, **edge)
