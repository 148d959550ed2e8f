"""Recorded properties of a capture's frames: the split into training and test views, and mask paths.

Sources: nerfstudio documentation, Data conventions (`train_filenames`, `val_filenames`, `test_filenames`,
`mask_path`); `nerfbaselines/nerfbaselines` (train_list.txt, test_list.txt beside a COLMAP scene);
`graphdeco-inria/gaussian-splatting`: scene/dataset_readers.py (test.txt in the folder of the COLMAP model).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Literal

from msb.base.files import is_file, read_file
from msb.errors import Finding, InputError, SceneError, finding, shorten
from msb.scenes.camera import Camera
from msb.scenes.checks import Split, check_name
from msb.scenes.colmap import find_model
from msb.scenes.datasets.catalog import Layout
from msb.scenes.datasets.layout import SINGLE, TEST, TRAIN, VALIDATION
from msb.scenes.json_node import read_json
from msb.scenes.sets import split_every_8th, stem
from msb.scenes.source import Source
from msb.scenes.transforms import image_name

# How the test views of a scene are chosen.
SplitSource = Literal["recorded", "every 8th", "benchmark"]
# Largest accepted list of names in bytes, enough for a hundred thousand names.
_MAX_LIST = 1 << 24
# Keys of transforms.json with the file names of a split.
_KEYS: dict[Split, str] = {"train": "train_filenames", "val": "val_filenames", "test": "test_filenames"}


@dataclass(frozen=True)
class SplitViews:
    """The views of a scene with their `split`, and the kind of split. Training views come first."""

    views: list[Camera]
    source: SplitSource
    notes: list[Finding]


def split_views(
    root: Path, layout: Layout, views: Sequence[Camera], *, by_name: bool, is_benchmark: bool
) -> SplitViews:
    """Split the views of a scene by its recorded split.

    Without a recorded split, every 8th view is a test view.

    If `by_name` is true, views are sorted by their full names. Otherwise, views are sorted by their names
    without folder and suffix. A benchmark dataset without transforms_train.json (`is_benchmark`) uses every
    8th view as a test view.
    """
    notes: list[Finding] = []
    recorded = None if is_benchmark and layout != "blender" else _read_split(root, layout, views, notes)
    if recorded is not None and any(split == "test" for split in recorded.values()):
        parts = {name: split for name, split in recorded.items() if split in ("train", "test")}
        split = [replace(view, split=parts[str(view.name)]) for view in views if view.name in parts]
        return SplitViews(sorted(split, key=lambda view: view.split == "test"), "recorded", notes)
    train, test = split_every_8th(views, (lambda view: view.name or "") if by_name else stem)
    return SplitViews([*train, *test], "benchmark" if is_benchmark else "every 8th", notes)


def check_split(root: Path, views: Sequence[Camera]) -> None:
    """Raise SCENE_LAYOUT if a scene has no training or no test view."""
    for split, what in (("train", "training"), ("test", "test")):
        if not any(view.split == split for view in views):
            text = f"its {len(views)} views include no {what} view"
            raise SceneError("SCENE_LAYOUT", text, file=root)


def _read_split(
    root: Path, layout: Layout, views: Sequence[Camera], notes: list[Finding]
) -> dict[str, Split] | None:
    """Return a mapping from view name to recorded split. If the scene records no split, return None.

    If no test views are recorded, the validation views become test views.
    """
    if layout == "blender":
        return {str(view.name): view.split for view in views if view.split is not None}
    listed = _read_lists(root, layout)
    lists = {split: names for split, (_, names) in listed.items() if names}
    if "test" not in lists and "val" in lists:
        lists["test"] = lists.pop("val")
    lists.pop("val", None)
    if "test" not in lists:
        return None
    # Find the views of the listed names. If only a list of test views exists, all other views are training
    # views.
    found = _NameTable(views)
    split: dict[str, Split] = {} if "train" in lists else {str(view.name): "train" for view in views}
    unknown: list[str] = []
    for part in ("train", "test"):
        for name in lists.get(part, ()):
            view = found.find(name)
            if view is None:
                unknown.append(name)
            else:
                split[view] = "train" if part == "train" else "test"
    file = next(place for place, _ in listed.values())
    if unknown:
        text = f"{len(unknown)} names of the split have no view, for example {shorten(unknown[0], 60)}"
        notes.append(finding("SCENE_LAYOUT", text, severity="warning", file=str(file)))
    if left := len(views) - len(split):
        text = f"{left} of {len(views)} views are not used, because no list of the split names them"
        notes.append(finding("SCENE_LAYOUT", text, severity="warning", file=str(file)))
    return split


class _NameTable:
    """Finds a view by its full name.

    A short name, without folders or suffix, is accepted if it identifies a single view.
    """

    def __init__(self, views: Iterable[Camera]) -> None:
        self._names: dict[str, set[str]] = {}
        for view in views:
            for spelling in _spellings(str(view.name)):
                self._names.setdefault(spelling, set()).add(str(view.name))

    def find(self, name: str) -> str | None:
        for spelling in _spellings(name.removeprefix("./")):
            if len(alike := self._names.get(spelling, set())) == 1:
                return next(iter(alike))
        return None


def _spellings(name: str) -> list[str]:
    """Return the name, and its forms without the first folder, without folders and without suffix."""
    path = PurePosixPath(name)
    paths = [path, PurePosixPath(*path.parts[1:]) if len(path.parts) > 1 else path, PurePosixPath(path.name)]
    return [str(part) for part in (*paths, *(part.with_suffix("") for part in paths if part.name))]


def _read_lists(root: Path, layout: Layout) -> dict[Split, tuple[Path, list[str]]]:
    """For each split, return the names of its views and the file that lists them."""
    if layout == "transforms":
        document = read_json(Source.open(root / SINGLE))
        lists = {split: document.get(key) for split, key in _KEYS.items()}
        named = {split: node for split, node in lists.items() if node is not None}
        if named:
            return {
                split: (root / SINGLE, [item.text() for item in node.items()])
                for split, node in named.items()
            }
    model = find_model(root) if layout == "colmap" else None
    places: dict[Split, list[Path]] = {"train": [root / "train_list.txt"], "test": [root / "test_list.txt"]}
    if model is not None and model != root:
        places["test"].append(model / "test.txt")
    read: dict[Split, tuple[Path, list[str]]] = {}
    for split, files in places.items():
        for file in files:
            if is_file(file) and split not in read:
                read[split] = file, _read_names(file)
    return read


def _read_names(file: Path) -> list[str]:
    """Return the names in a text file that has one name per line."""
    data = read_file(file, _MAX_LIST)
    try:
        if len(data) > _MAX_LIST:
            raise ValueError
        lines = data.decode("utf-8-sig").splitlines()
    except ValueError:
        text = f"it is not a list of file names in UTF-8 of at most {_MAX_LIST} bytes"
        raise InputError("FILE_UNREADABLE", text, file=file) from None
    return [line.strip() for line in lines if line.strip()]


def read_mask_paths(root: Path, layout: Layout) -> Mapping[str, str]:
    """Return the recorded mask path of each view by name, relative to the scene, from transforms.json."""
    files = {"transforms": (SINGLE,), "blender": (TRAIN, TEST, VALIDATION)}.get(layout, ())
    masks: dict[str, str] = {}
    for name in files:
        if is_file(root / name):
            for frame in read_json(Source.open(root / name))["frames"].items():
                path = frame.get("mask_path")
                if path is not None:
                    mask = path.text().removeprefix("./")
                    with path.locating():
                        check_name(mask)  # reject an invalid name before searching its file
                    masks[image_name(frame["file_path"].text())] = mask
    return masks
