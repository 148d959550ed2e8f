"""Find the official rendering of each test camera, and check that no image is missing."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msb.base.files import file_sha256, is_folder
from msb.base.paths import normal_form
from msb.bench.digest import list_sha256
from msb.bench.records import File
from msb.bench.validation import read_bytes
from msb.errors import InputError, MetricError, shorten
from msb.metrics.image_files import read_image
from msb.metrics.pairs import images_below
from msb.render.images import image_names
from msb.scenes import Camera
from msb.scenes.image_size import IMAGE_SUFFIXES as PHOTOGRAPHS
from msb.scenes.image_size import image_size

# Name of an optional file in the format of ``sha256sum``. If this file exists, it must list the hash of every
# image.
SUMS = "SHA256SUMS"
# Maximum size of SHA256SUMS in bytes, enough for a hundred thousand lines.
_MAX_SUMS = 16 << 20
# Maximum number of file names in an error message.
_MAX_NAMES = 4


@dataclass(frozen=True)
class Renders:
    """A folder of official renderings."""

    # One image file per camera, in the order of the cameras.
    files: tuple[Path, ...]
    # Matching by "name": images have the names of the photographs. Matching by "number": images are called
    # 00000, 00001, ... in the order of the test views, as in code derived from 3DGS.
    matched_by: Literal["name", "number"]
    # Path and size of the folder, and the SHA-256 of the list of file hashes.
    folder: File


def find_renders(folder: Path, cameras: Sequence[Camera]) -> Renders:
    """Return the official rendering of each test camera of a scene."""
    if not is_folder(folder):
        raise InputError("FILE_NOT_FOUND", "the folder of renderings does not exist", file=folder)
    images = images_below(folder)
    # Images are matched by number only if their names are exactly the numbers of the test views.
    names = [normal_form(name) for name in image_names(cameras)]
    numbers = [f"{index:05d}" for index in range(len(cameras))]
    by_number = set(images) == set(numbers) != set(names)
    expected = numbers if by_number else names
    _check_names(folder, set(images), set(expected))
    files = tuple(images[name] for name in expected)
    hashes = [(file.relative_to(folder).as_posix(), file_sha256(file)) for file in files]
    _check_sums(folder / SUMS, dict(hashes))
    size = sum(file.stat().st_size for file in files)
    about = File(path=str(folder), bytes=size, sha256=list_sha256(hashes))
    return Renders(files, "number" if by_number else "name", about)


def measure_size(path: Path) -> tuple[int, int]:
    """Return width and height of a rendering in pixels. Only the header of a PNG or JPEG is read."""
    if path.suffix.lower() in PHOTOGRAPHS:
        return image_size(path)
    height, width = read_image(path).shape[:2]
    return width, height


def check_size(path: Path, size: tuple[int, int], camera: Camera) -> None:
    """Raise METRIC_SIZES_DIFFER if a rendering does not have the size of its photograph."""
    if size != (camera.width, camera.height):
        text = (
            f"the image has {size[0]} x {size[1]} pixels, but the photograph {camera.width} x {camera.height}"
        )
        raise MetricError("METRIC_SIZES_DIFFER", text, file=path)


def _check_names(folder: Path, present: set[str], expected: set[str]) -> None:
    """Raise METRIC_IMAGE_NAMES if an image is missing or does not belong to a test view."""
    for names, fault in ((expected - present, "missing images"), (present - expected, "unknown images")):
        if names:
            listed = ", ".join(shorten(name, 60) for name in sorted(names)[:_MAX_NAMES])
            more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
            text = (
                f"{fault}: {listed}{more}. The folder must contain one image for each of the "
                f"{len(expected)} test views, named like its photograph, or 00000, 00001, ... in their order"
            )
            raise MetricError("METRIC_IMAGE_NAMES", text, file=folder)


def _check_sums(path: Path, hashes: dict[str, str]) -> None:
    """Raise RENDERS_CHANGED if the file `path` exists and differs from `hashes` (SHA-256 by name)."""
    if not path.is_file():
        return
    try:
        lines = read_bytes(path, _MAX_SUMS, "FILE_UNREADABLE").decode().splitlines()
    except UnicodeDecodeError as error:
        raise InputError("FILE_UNREADABLE", f"the file is not UTF-8: {error}", file=path) from error
    listed = {
        normal_form(match[2]).removeprefix("./"): match[1].lower()
        for line in lines
        if (match := re.fullmatch(r"(\w{64}) [ *](.+)", line))
    }
    for file, sha256 in hashes.items():
        name = normal_form(file)
        if listed.get(name) != sha256:
            fault = "has another hash" if name in listed else "is not listed"
            raise InputError("RENDERS_CHANGED", f"{name} {fault}", file=path)
