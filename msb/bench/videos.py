"""Write videos that show the conditions of a method side by side.

Also write grids that show the videos of all methods of a scene.
"""

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
from msb.bench.digest import digest
from msb.bench.folder import RESULT, Results, check_run
from msb.bench.photographs import read_planned_scene
from msb.bench.quality import open_renderer
from msb.bench.records import Cell, read_result
from msb.bench.validation import read_json
from msb.errors import MsbError
from msb.registry import METHODS
from msb.render.images import image_names, read_film, to_bytes, write_film
from msb.scenes import Camera, interpolate_cameras

if TYPE_CHECKING:
    from PIL.Image import Image

    from msb.bench.job import Job
    from msb.bench.protocol_tables import VideosTable

SCHEMA = "msb.video/1"
PHOTOGRAPH = "photograph"
# Ratio of the title's height to the image's height.
_TITLE_HEIGHT = 1 / 20
# Minimum height of a video in pixels. Smaller images are enlarged by an integer factor.
_MIN_HEIGHT = 240
# Maximum size in bytes of the JSON file beside a video.
_MAX_BYTES = 1 << 16


@dataclass(frozen=True)
class FilmTask:
    """A task for a worker process: write the video of a method on a scene, or the grid of a scene."""

    # Dataset and scene of the video. For the video of one method, `names` also includes the model.
    names: tuple[str, ...]
    # The benchmark jobs in display order. The jobs are the conditions of one video, or the methods of a grid.
    jobs: tuple[Job, ...]
    options: VideosTable
    # The hash of all inputs of the video.
    inputs: str

    @property
    def name(self) -> str:
        """The name of the task in progress lines."""
        return " ".join(self.names)

    @property
    def path(self) -> Path:
        """The path of the video."""
        return Results(self.jobs[0].root).video(*self.names)

    @property
    def is_done(self) -> bool:
        """Whether the video exists and was made from the current inputs."""
        return _read_description(self.path).get("inputs") == self.inputs


def plan_videos(options: VideosTable, jobs: Sequence[Job]) -> list[FilmTask]:
    """Return the missing or outdated videos of finished benchmark cells.

    A video along the path "flight" shows only conditions that our renderers can draw. Official renderings and
    photographs exist only at the test views.
    """
    # Collect the benchmark jobs for each video, one job per renderer condition. The keys of the dictionary
    # are dataset, scene and model.
    groups: dict[tuple[str, ...], list[Job]] = {}
    for job in jobs:
        is_rendered = job.cell.condition in ("dedicated", "standard")
        if is_rendered or (job.cell.condition == "non_engine" and options.path == "test"):
            groups.setdefault(job.cell.names[:3], []).append(job)
    tasks = []
    for names, group in groups.items():
        finished: list[tuple[Job, Any]] = []
        for job in group:
            with contextlib.suppress(MsbError):
                result = Results(job.root).read(job.cell)
                if result.status == "done":
                    finished.append((job, result.inputs["quality"]))
        if finished:
            inputs = digest(
                [options.model_dump(), [(job.cell.condition_name, inputs) for job, inputs in finished]]
            )
            tasks.append(FilmTask(names, tuple(job for job, _ in finished), options, inputs))
    return [task for task in tasks if not task.is_done]


def plan_grids(options: VideosTable, jobs: Sequence[Job]) -> list[FilmTask]:
    """Return the grids to write: one grid for each scene with videos of at least two methods."""
    # For each scene, collect the first job of each model.
    scenes: dict[tuple[str, str], dict[str, Job]] = {}
    for job in jobs:
        dataset, scene, model, _ = job.cell.names
        scenes.setdefault((dataset, scene), {}).setdefault(model, job)
    tasks = []
    for names, models in scenes.items():
        inputs = {
            model: _read_description(_get_film_path(job)).get("inputs") for model, job in models.items()
        }
        filmed = tuple(job for model, job in models.items() if inputs[model] is not None)
        if len(filmed) > 1:
            tasks.append(FilmTask(names, filmed, options, digest(["grid", inputs])))
    return [task for task in tasks if not task.is_done]


def _get_film_path(job: Job) -> Path:
    """Return the path of a video. The video shows the model of a benchmark job in its scene."""
    return Results(job.root).video(*job.cell.names[:3])


def _read_description(film: Path) -> dict[str, Any]:
    """Return the content of the JSON file beside a video.

    If the video or the JSON file is missing, the content is empty.
    """
    with contextlib.suppress(MsbError):
        description = read_json(film.with_suffix(".json"), _MAX_BYTES)
        if isinstance(description, dict) and film.exists():
            return description
    return {}


def write_video(task: FilmTask) -> None:
    """Render and write the video of a method, and a JSON file that describes the video."""
    first = task.jobs[0]
    check_run(first.root, first.run)
    scene = read_planned_scene(first.scene, first.views)
    titles = [_get_condition_title(job.cell) for job in task.jobs]
    with contextlib.ExitStack() as stack:
        if task.options.path == "test":
            titles = [PHOTOGRAPH.capitalize(), *titles]
            frames = _read_test_frames(task, image_names(scene.test))
        else:
            cameras = interpolate_cameras(scene.test, task.options.frames)
            frames = _render_flight(task, cameras, scene.background, stack)
        write_film(task.path, (label_images(row, titles) for row in frames), task.options.fps)
    _write_description(task, columns=titles)


def write_grid(task: FilmTask) -> None:
    """Write a video that stacks the videos of all methods of a scene, and a JSON file that describes the
    video.

    Each row of the video shows a method, and each column a condition.
    """
    check_run(task.jobs[0].root, task.jobs[0].run)
    films, models = [_get_film_path(job) for job in task.jobs], [job.cell.model_name for job in task.jobs]
    captions = [_read_description(film)["columns"] for film in films]
    # The method with the most conditions comes first and determines the order of the columns.
    columns = list(
        dict.fromkeys(title for titles in sorted(captions, key=len, reverse=True) for title in titles)
    )
    panels = [_read_panels(film, titles) for film, titles in zip(films, captions, strict=True)]
    rows = zip(*panels, strict=False)
    titles = [_get_model_title(job.cell) for job in task.jobs]
    absent = [_find_unsupported_titles(job) for job in task.jobs]
    write_film(task.path, (_draw_grid(row, columns, titles, absent) for row in rows), task.options.fps)
    _write_description(task, columns=columns, rows=models)


def _get_condition_title(cell: Cell) -> str:
    """Return the title of a condition, such as "Standard" or "Dedicated, engine" for a variant."""
    tier, _, name = cell.condition_key.partition("/")
    return f"{CONDITION_TITLES[tier]}, {name}" if name else CONDITION_TITLES[tier]


def _get_model_title(cell: Cell) -> str:
    """Return the title of a method, preceded by the label of the model if the model has a label."""
    method = METHODS[cell.method].title if cell.method in METHODS else cell.method
    return f"{cell.label} ({method})" if cell.label else method


def _find_unsupported_titles(job: Job) -> set[str]:
    """Return the titles of the conditions that a model does not support."""
    titles = set()
    for path in sorted(Results(job.root).cell(job.cell).parent.glob(f"*/{RESULT}")):
        with contextlib.suppress(MsbError):
            result = read_result(path)
            if result.status == "unsupported":
                titles.add(_get_condition_title(result.cell))
    return titles


def _read_panels(film: Path, titles: Sequence[str]) -> Iterator[dict[str, NDArray[np.uint8]]]:
    """For each frame of a method's video, yield a mapping from the title of each condition to the image."""
    for pixels in read_film(film):
        width = pixels.shape[1] // len(titles)
        yield {title: pixels[:, n * width : (n + 1) * width] for n, title in enumerate(titles)}


def _draw_grid(
    rows: Sequence[dict[str, NDArray[np.uint8]]],
    columns: Sequence[str],
    titles: Sequence[str],
    absent: Sequence[set[str]],
) -> NDArray[np.float32]:
    """Return one frame of a grid, (H, W, 3) with values from 0 to 1.

    For each method, `rows` maps the title of a condition to the image. `columns` lists the titles of all
    conditions. `titles` lists the titles of the methods. `absent` lists the unsupported conditions of each
    method.
    """
    from PIL import Image

    # All panels are scaled to the size of the largest panel. A missing panel is black. The text in a black
    # panel states whether the method supports the condition.
    width, height = (max(panel.shape[axis] for row in rows for panel in row.values()) for axis in (1, 0))
    picture = Image.new("RGB", (width * len(columns), height * len(rows)))
    for y, (row, name, unsupported) in enumerate(zip(rows, titles, absent, strict=True)):
        for x, title in enumerate(columns):
            if title in row:
                picture.paste(Image.fromarray(row[title]).resize((width, height)), (x * width, y * height))
            else:
                why = "N/A" if title in unsupported else "not rendered"
                _draw_title(picture, f"{title}: {why}", (x * width, y * height), height)
        _draw_title(picture, name, (0, (y + 1) * height - 2 * round(height * _TITLE_HEIGHT)), height)
    return np.asarray(picture, np.float32) / np.float32(255)


def _write_description(task: FilmTask, **axes: list[str]) -> None:
    """Write the JSON file beside a video. `axes` lists the columns and rows of the video."""
    description = {"schema": SCHEMA, "inputs": task.inputs, **axes, **task.options.model_dump()}
    with new_file(task.path.with_suffix(".json")) as file:
        file.write(json.dumps(description, indent=1).encode() + b"\n")


def _render_flight(
    task: FilmTask,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    stack: contextlib.ExitStack,
) -> Iterator[list[NDArray[Any]]]:
    """For each camera of a smooth camera path, yield the images of all conditions."""
    renderers = [stack.enter_context(open_renderer(job)) for job in task.jobs]
    for camera in cameras:
        yield [to_bytes(renderer.render(camera, background).image) for renderer in renderers]


def _read_test_frames(task: FilmTask, names: Sequence[str]) -> Iterator[list[NDArray[Any]]]:
    """Yield the stored images of the test views. Every image is repeated for the same number of frames."""
    folders = [task.jobs[0].photographs, *(job.folder / "images" for job in task.jobs)]
    last, row = None, []
    for frame in range(task.options.frames):
        name = names[frame * len(names) // task.options.frames]
        if name != last:
            last, row = name, [metrics.read_image(folder / f"{name}.png") for folder in folders]
        yield row


def label_images(images: Sequence[NDArray[Any]], titles: Sequence[str]) -> NDArray[np.float32]:
    """Return images of equal size, (H, W, 3) uint8, side by side. A title is drawn in the corner of each
    image.

    The result has values from 0 to 1.
    """
    from PIL import Image

    times = -(-_MIN_HEIGHT // images[0].shape[0])
    pixels = np.concatenate(images, axis=1).repeat(times, axis=0).repeat(times, axis=1)
    height, width = pixels.shape[0], pixels.shape[1] // len(images)
    picture = Image.fromarray(pixels)
    for number, title in enumerate(titles):
        _draw_title(picture, title, (number * width, 0), height)
    return np.asarray(picture, np.float32) / np.float32(255)


def _draw_title(picture: Image, title: str, corner: tuple[int, int], height: int) -> None:
    """Draw a title with its top left at `corner`.

    The font size depends on `height`, the height of a panel in pixels.
    """
    from PIL import ImageDraw, ImageFont

    size = round(height * _TITLE_HEIGHT)
    place = (corner[0] + size // 2, corner[1] + size // 2)
    font = ImageFont.load_default(size)
    edge: dict[str, Any] = {"stroke_width": size // 10, "stroke_fill": (0, 0, 0)}
    ImageDraw.Draw(picture).text(place, title, (255, 255, 255), font, **edge)
