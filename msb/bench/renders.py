"""Official renderings, made elsewhere: which image belongs to which camera, and whether all are there."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msb.base.files import file_sha256, is_folder
from msb.base.paths import normal_form
from msb.bench.checked import read_bytes
from msb.bench.digest import list_sha256
from msb.bench.records import File
from msb.errors import InputError, MetricError, shorten
from msb.metrics.image_files import read_image
from msb.metrics.pairs import images_below
from msb.render.images import image_names
from msb.scenes import Camera
from msb.scenes.image_size import IMAGE_SUFFIXES as PHOTOGRAPHS
from msb.scenes.image_size import image_size

# A file as ``sha256sum`` writes it. If it exists, it must list every image with its present hash.
SUMS = "SHA256SUMS"
# Most bytes of that file: a hundred thousand lines.
_MAX_SUMS = 16 << 20
_NAMED = 4


@dataclass(frozen=True)
class Renders:
    """A folder of official renderings."""

    # The file of each camera, in the cameras' order.
    files: tuple[Path, ...]
    # "name" if images have the names of the photographs; "number" if they are called 00000, 00001, ... in
    # the order of the test views, as the 3DGS family writes them.
    matched_by: Literal["name", "number"]
    # Its `sha256` is that of the images' list of hashes.
    folder: File


def find_renders(folder: Path, cameras: Sequence[Camera]) -> Renders:
    """Return the rendering of each of the cameras, all test views of a scene."""
    if not is_folder(folder):
        raise InputError("FILE_NOT_FOUND", "there is no such folder of renderings", file=folder)
    images = images_below(folder)
    names = [normal_form(name) for name in image_names(cameras)]
    numbers = [f"{index:05d}" for index in range(len(cameras))]
    by_number = set(images) == set(numbers) != set(names)
    wanted = numbers if by_number else names
    _check_names(folder, set(images), set(wanted))
    files = tuple(images[name] for name in wanted)
    hashes = [(file.relative_to(folder).as_posix(), file_sha256(file)) for file in files]
    _check_sums(folder / SUMS, dict(hashes))
    size = sum(file.stat().st_size for file in files)
    about = File(path=str(folder), bytes=size, sha256=list_sha256(hashes))
    return Renders(files, "number" if by_number else "name", about)


def stored_size(path: Path) -> tuple[int, int]:
    """Return width and height of a rendering, of a PNG or JPEG from its header alone."""
    if path.suffix.lower() in PHOTOGRAPHS:
        return image_size(path)
    height, width = read_image(path).shape[:2]
    return width, height


def check_size(path: Path, size: tuple[int, int], camera: Camera) -> None:
    """Refuse a rendering that has not the size of the photograph of its camera."""
    if size != (camera.width, camera.height):
        text = f"it is {size[0]} x {size[1]}, the photograph {camera.width} x {camera.height}"
        raise MetricError("METRIC_SIZES_DIFFER", text, file=path)


def _check_names(folder: Path, found: set[str], wanted: set[str]) -> None:
    for names, what in ((wanted - found, "missing"), (found - wanted, "of no test view")):
        if names:
            shown = ", ".join(shorten(name, 60) for name in sorted(names)[:_NAMED])
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            verb = "is" if len(names) == 1 else "are"
            text = (
                f"{shown}{more} {verb} {what}; there must be one image for each of the {len(wanted)} "
                "test views, called as its photograph, or 00000, 00001, ... in their order"
            )
            raise MetricError("METRIC_IMAGE_NAMES", text, file=folder)


def _check_sums(path: Path, hashes: dict[str, str]) -> None:
    if not path.is_file():
        return
    try:
        lines = read_bytes(path, _MAX_SUMS, "FILE_UNREADABLE").decode().splitlines()
    except UnicodeDecodeError as error:
        raise InputError("FILE_UNREADABLE", f"it is not UTF-8: {error}", file=path) from error
    said = {
        normal_form(match[2]): match[1].lower()
        for line in lines
        if (match := re.fullmatch(r"(\w{64}) [ *](.+)", line))
    }
    for file, sha256 in hashes.items():
        name = normal_form(file)
        if said.get(name.removeprefix("./"), said.get(f"./{name}")) != sha256:
            what = "has another hash in it" if name in said or f"./{name}" in said else "is not in it"
            raise InputError("RENDERS_CHANGED", f"{name} {what}", file=path)
