"""Pair the images that are compared, by full relative name and never by their place in a list."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from msb.base.files import open_error
from msb.base.paths import given_path, normal_form
from msb.errors import InputError, MetricError, shorten
from msb.metrics.image_files import IMAGE_SUFFIXES

# Number of names that an error lists; it only counts the others.
_NAMED = 5
_PLANES = tuple(f"{kind}{suffix}" for kind in ("_depth", "_ids") for suffix in (".npy", ".exr"))


class ImagePair(NamedTuple):
    """Two files to compare."""

    # The path below the folder, with forward slashes and without suffix, in Unicode's composed form.
    name: str
    pred: Path
    gt: Path


def pair_images(
    pred: str | os.PathLike[str], gt: str | os.PathLike[str], *, subset: bool = False
) -> list[ImagePair]:
    """Return the pairs of two folders with all below them, or of two files, sorted by name.

    Names are compared without their suffix, which is one of `IMAGE_SUFFIXES`, and in Unicode's composed form
    (NFC); hidden files do not count, nor do the depths and face ids that `msb render` writes beside an
    image. With `subset`, `gt` may hold more images, such as the training views.
    """
    pred, gt = given_path(pred), given_path(gt)
    folders = [_is_folder(each) for each in (pred, gt)]
    if not any(folders):
        return [ImagePair(pred.stem, pred, gt)]
    if not all(folders):
        file, folder = (pred, gt) if folders[1] else (gt, pred)
        text = f"it is a file and {shorten(str(folder))} a folder; give two of a kind"
        raise InputError("FILE_NOT_RECOGNISED", text, file=file)
    files, wanted = images_below(pred), images_below(gt)
    missing = sorted(set(files) - set(wanted))
    if missing:
        text = f"{_listed(missing, pred)} not there; names must be the same but for the suffix"
        raise MetricError("METRIC_IMAGE_NAMES", text, file=gt)
    extra = sorted(set(wanted) - set(files))
    if extra and not subset:
        text = f"{_listed(extra, gt)} not there; --subset compares those there are"
        raise MetricError("METRIC_IMAGE_NAMES", text, file=pred)
    return [ImagePair(name, files[name], wanted[name]) for name in sorted(files)]


def _is_folder(path: Path) -> bool:
    try:
        path.stat()
    except (OSError, ValueError) as error:
        raise open_error(error, path, "file or folder") from error
    return path.is_dir()


def images_below(folder: Path) -> dict[str, Path]:
    """Return name -> file of the images in `folder` and below; names and errors as for `pair_images`."""

    def refuse(error: OSError) -> None:
        text = f"it cannot be read: {error.strerror}"
        raise InputError("FILE_UNREADABLE", text, file=error.filename or folder) from error

    images: dict[str, Path] = {}
    for root, folders, names in os.walk(folder, onerror=refuse):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for path in _pictures(Path(root), names):
            name = normal_form(path.relative_to(folder).with_suffix("").as_posix())
            if name in images:
                alike = normal_form(images[name].name) == normal_form(path.name)
                how = "in different Unicode normal forms" if alike else "but for the suffix"
                text = f"{images[name].name} and {path.name} have the same name, {how}; leave one of them"
                raise MetricError("METRIC_IMAGE_NAMES", text, file=path.parent)
            images[name] = path
    if not images:
        text = f"there is no image in it; suffixes are {', '.join(IMAGE_SUFFIXES)}"
        raise MetricError("METRIC_IMAGE_NAMES", text, file=folder)
    return images


def _pictures(folder: Path, names: Iterable[str]) -> list[Path]:
    paths = [folder / name for name in sorted(names) if not name.startswith(".")]
    paths = [path for path in paths if path.suffix.lower() in IMAGE_SUFFIXES]
    stems = {path.stem for path in paths}
    return [
        path for path in paths if not path.name.endswith(_PLANES) or path.stem.rpartition("_")[0] not in stems
    ]


def _listed(names: list[str], folder: Path) -> str:
    shown = ", ".join(shorten(name, 60) for name in names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{shown}{more} of {shorten(str(folder))} {'is' if len(names) == 1 else 'are'}"
