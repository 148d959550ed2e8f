"""Pair images for comparison by their full relative names, never by their positions in a list."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from msb.base.files import open_error
from msb.base.paths import given_path, normal_form
from msb.errors import InputError, MetricError, shorten
from msb.metrics.image_files import IMAGE_SUFFIXES

# Number of names that an error message lists. If there are more names, only their number is given.
_NAMED = 5
_PLANES = tuple(f"{kind}{suffix}" for kind in ("_depth", "_ids") for suffix in (".npy", ".exr"))


class ImagePair(NamedTuple):
    """Two image files to compare."""

    # Path of the image relative to the folder, with forward slashes and without suffix, in composed Unicode
    # (NFC).
    name: str
    pred: Path
    gt: Path


def pair_images(
    pred: str | os.PathLike[str], gt: str | os.PathLike[str], *, subset: bool = False
) -> list[ImagePair]:
    """Return pairs of images from two folders and their subfolders, or from two files, sorted by name.

    Names are compared in composed Unicode (NFC), without suffix. The suffix of an image must be one of
    `IMAGE_SUFFIXES`. Hidden files are ignored. The depth and face id images of `msb render` are ignored too.
    If `subset` is true, the folder `gt` may contain further images, such as training views.
    """
    pred, gt = given_path(pred), given_path(gt)
    folders = [_is_folder(path) for path in (pred, gt)]
    if not any(folders):
        return [ImagePair(pred.stem, pred, gt)]
    if not all(folders):
        file, folder = (pred, gt) if folders[1] else (gt, pred)
        text = f"this is a file, but {shorten(str(folder))} is a folder; pass two files or two folders"
        raise InputError("FILE_NOT_RECOGNISED", text, file=file)
    files, expected = images_below(pred), images_below(gt)
    missing = sorted(set(files) - set(expected))
    if missing:
        text = (
            f"{_list_names(missing, pred)} missing in this folder; "
            "names of a pair must be equal except for the suffix"
        )
        raise MetricError("METRIC_IMAGE_NAMES", text, file=gt)
    extra = sorted(set(expected) - set(files))
    if extra and not subset:
        text = f"{_list_names(extra, gt)} missing here; use --subset to compare only the existing images"
        raise MetricError("METRIC_IMAGE_NAMES", text, file=pred)
    return [ImagePair(name, files[name], expected[name]) for name in sorted(files)]


def _is_folder(path: Path) -> bool:
    try:
        path.stat()
    except (OSError, ValueError) as error:
        raise open_error(error, path, "file or folder") from error
    return path.is_dir()


def images_below(folder: Path) -> dict[str, Path]:
    """Return the image files in `folder` and its subfolders.

    The keys are the names that `pair_images` compares.
    """

    def reject(error: OSError) -> None:
        text = f"the folder cannot be read: {error.strerror}"
        raise InputError("FILE_UNREADABLE", text, file=error.filename or folder) from error

    images: dict[str, Path] = {}
    for root, folders, names in os.walk(folder, onerror=reject):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for path in _select_images(Path(root), names):
            name = normal_form(path.relative_to(folder).with_suffix("").as_posix())
            if name in images:
                alike = normal_form(images[name].name) == normal_form(path.name)
                how = "in different Unicode normal forms" if alike else "except for the suffix"
                text = f"{images[name].name} and {path.name} have the same name, {how}; remove one of them"
                raise MetricError("METRIC_IMAGE_NAMES", text, file=path.parent)
            images[name] = path
    if not images:
        text = f"the folder contains no images; supported suffixes: {', '.join(IMAGE_SUFFIXES)}"
        raise MetricError("METRIC_IMAGE_NAMES", text, file=folder)
    return images


def _select_images(folder: Path, names: Iterable[str]) -> list[Path]:
    paths = [folder / name for name in sorted(names) if not name.startswith(".")]
    paths = [path for path in paths if path.suffix.lower() in IMAGE_SUFFIXES]
    stems = {path.stem for path in paths}
    return [
        path for path in paths if not path.name.endswith(_PLANES) or path.stem.rpartition("_")[0] not in stems
    ]


def _list_names(names: list[str], folder: Path) -> str:
    listed = ", ".join(shorten(name, 60) for name in names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{listed}{more} of {shorten(str(folder))} {'is' if len(names) == 1 else 'are'}"
