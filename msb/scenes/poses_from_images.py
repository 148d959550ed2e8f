"""Camera poses, a lens and points from photographs alone: structure from motion with pycolmap (COLMAP)."""

from __future__ import annotations

import concurrent.futures
import contextlib
import sqlite3
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import need_extra
from msb.errors import SceneError
from msb.scenes.camera import Camera
from msb.scenes.colmap import read_model, read_points
from msb.scenes.image_size import read_header

# The photographs that are compared with each other: all pairs, or neighbours in the order of file names.
Matching = Literal["exhaustive", "sequential"]
# Camera model of an unknown camera in COLMAP, with one focal length and one radial coefficient.
_LENS = "SIMPLE_RADIAL"
# Number of neighbours compared with each photograph of a sequence: COLMAP's default for video frames.
_OVERLAP = 10
# Seconds between two progress updates.
_PAUSE = 0.3

# Callback with the stage, the number of finished steps, and the total number of steps.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class FoundPoses:
    """The result of structure from motion.

    Attributes
    ----------
    cameras : list of Camera
        The registered photographs, with the recovered lens distortion.
    points : (N, 3) float64 and (N, 3) uint8
        Points and their colours.
    reprojection_error : float
        Mean distance in pixels between an observed point and its projection.
    models : tuple of int
        The numbers of registered photographs in all models, largest first. The first model is the result.
    """

    cameras: list[Camera]
    points: tuple[NDArray[np.float64], NDArray[np.uint8]]
    reprojection_error: float
    models: tuple[int, ...]


def find_poses(
    folder: Path, names: Sequence[str], matching: Matching, seed: int, progress: Progress
) -> FoundPoses:
    """Find the poses of photographs, and the lens that the photographs share.

    Photographs of one size share a lens, unless the EXIF data name several cameras. If the EXIF data name
    several cameras, each camera has a separate lens. Poses and the scale of the world are relative, because
    photographs contain no absolute length.

    Parameters
    ----------
    folder : Path
        The folder of the photographs.
    names : sequence of str
        The names of the photographs below the folder.
    matching : {"exhaustive", "sequential"}
    seed : int
        Seed of the random search. Results still differ in the last digits, because the order of computations
        in several threads varies.

    Raises
    ------
    UsageError
        EXTRA_MISSING: pycolmap is not installed.
    SceneError
        CAPTURE_FAILED: no two photographs show the same surface from two positions.
    """
    need_extra("capture", "pycolmap", what="finding camera poses")
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    pycolmap.set_random_seed(seed)
    sizes = {read_header(folder / name).size for name in names}
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = _LENS
    mode = pycolmap.CameraMode.SINGLE if len(sizes) == 1 else pycolmap.CameraMode.AUTO
    count = len(names)
    with tempfile.TemporaryDirectory(prefix="msb-capture-") as place:
        work, database = Path(place), Path(place) / "database.db"
        job = _Job(progress, database, pycolmap.CancellationToken())
        job.run(
            ("finding features", "keypoints", count),
            lambda token: pycolmap.extract_features(
                database,
                folder,
                image_names=list(names),
                camera_mode=mode,
                reader_options=reader,
                cancellation_token=token,
            ),
        )
        pairs = count * (count - 1) // 2
        if matching == "sequential":
            options = pycolmap.SequentialPairingOptions()
            options.overlap = _OVERLAP
            options.loop_detection = False
            match: Callable[[Any], Any] = lambda token: pycolmap.match_sequential(  # noqa: E731
                database, pairing_options=options, cancellation_token=token
            )
            pairs = min(pairs, count * _OVERLAP)
        else:
            match = lambda token: pycolmap.match_exhaustive(database, cancellation_token=token)  # noqa: E731
        job.run(("comparing photographs", "two_view_geometries", pairs), match)
        models = job.run(
            ("finding poses", None, count),
            lambda token: pycolmap.incremental_mapping(
                database, folder, work, next_image_callback=job.step, cancellation_token=token
            ),
        )
        return _read_result(models, folder, work / "result", count)


class _Job:
    """Runs stages in a thread, reports their progress, and cancels them on Ctrl-C."""

    def __init__(self, progress: Progress, database: Path, token: Any) -> None:
        self._progress, self._database, self._token = progress, database, token
        self._steps = 0

    def step(self) -> None:
        """Count one finished step."""
        self._steps += 1

    def run(self, stage: tuple[str, str | None, int], work: Callable[[Any], Any]) -> Any:
        """Run `work` in a thread, and return its result.

        `stage` contains the name of the work, the database table, and the number of steps. Each step adds a
        row to the database table.
        """
        name, table, total = stage
        self._steps = 0
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            future = pool.submit(work, self._token)
            try:
                while not future.done():
                    concurrent.futures.wait([future], _PAUSE)
                    done = self._steps if table is None else self._count(table)
                    self._progress(name, min(done, total), total)
            except BaseException:
                self._token.cancel()
                raise
            return future.result()

    def _count(self, table: str) -> int:
        """Return the number of rows of a database table. If the database is locked or empty, return 0."""
        with contextlib.suppress(sqlite3.Error):
            place = f"{self._database.absolute().as_uri()}?mode=ro"
            with contextlib.closing(sqlite3.connect(place, uri=True, timeout=0.05)) as database:
                return int(database.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
        return 0


def _read_result(models: dict[int, Any], folder: Path, work: Path, count: int) -> FoundPoses:
    """Return the cameras and the points of the largest model."""
    found = sorted(models.values(), key=lambda model: model.num_reg_images(), reverse=True)
    if not found:
        text = (
            f"no poses were found for its {count} photographs: no two photographs show the same surface from "
            f"two positions. Take sharp photographs while you walk around the object, so that neighbours "
            f"overlap by two thirds; plain walls, mirrors and moving objects cannot be matched"
        )
        raise SceneError("CAPTURE_FAILED", text, file=folder)
    work.mkdir()
    found[0].write_text(work)
    return FoundPoses(
        read_model(work),
        read_points(work),
        float(found[0].compute_mean_reprojection_error()),
        tuple(model.num_reg_images() for model in found),
    )
