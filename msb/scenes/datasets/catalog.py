"""The datasets of the benchmark, their scenes and groups of scenes."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from msb.scenes.colors import WHITE, Color

# Default dataset name for a capture that belongs to no known dataset.
CUSTOM = "custom"

# Layout of a scene's folder. The layout "colmap" has sparse/, and "neus" has cameras.npz. The layout
# "blender" has transforms_train.json and transforms_test.json, and "transforms" has transforms.json without a
# split.
Layout = Literal["colmap", "blender", "transforms", "neus"]


@dataclass(frozen=True)
class Dataset:
    """A dataset.

    Attributes
    ----------
    title : str
    scenes : mapping of str to str
        The group of each scene. In datasets without groups, the group is "".
    names : pattern
        File names of the published photographs, without folders.
    sizes : mapping of str to set of (int, int)
        The recorded camera sizes of each published scene. The key "" is used for all other scenes.
    masked : bool
        Whether photographs have a mask. If the value is true, only the masked object is evaluated, over
        `background`.
    background : Color, optional
        The background of photographs and renderings; None if it depends on the method (`Rules.backgrounds`).
    folders : tuple of str
        Published packages have these lower-case names of the parent folder of the scenes.
    views : (int, int), optional
        The numbers of training and test views, if all scenes have the same numbers.
    layouts : tuple of Layout
        The layouts of published packages.
    """

    title: str
    scenes: Mapping[str, str]
    names: re.Pattern[str]
    sizes: Mapping[str, set[tuple[int, int]]]
    masked: bool = False
    background: Color | None = None
    folders: tuple[str, ...] = ()
    views: tuple[int, int] | None = None
    layouts: tuple[Layout, ...] = ("colmap",)


_INDOOR, _OUTDOOR = (
    ("room", "counter", "kitchen", "bonsai"),
    ("bicycle", "flowers", "garden", "stump", "treehill"),
)
_OBJECTS = ("chair", "drums", "ficus", "hotdog", "lego", "materials", "mic", "ship")
_SCANS = (24, 37, 40, 55, 63, 65, 69, 83, 97, 105, 106, 110, 114, 118, 122)

# The datasets by id, in the order of the tables in the paper.
DATASETS: dict[str, Dataset] = {
    "mipnerf360": Dataset(
        "Mip-NeRF 360",
        dict.fromkeys(_OUTDOOR, "outdoor") | dict.fromkeys(_INDOOR, "indoor"),
        re.compile(r"_?DSCF?\d{4,5}\.JPG"),
        {
            "bicycle": {(4946, 3286)},
            "flowers": {(5025, 3312)},
            "garden": {(5187, 3361)},
            "stump": {(4978, 3300)},
            "treehill": {(5068, 3326)},
            "room": {(3114, 2075)},
            "counter": {(3115, 2076)},
            "kitchen": {(3115, 2078)},
            "bonsai": {(3118, 2078)},
        },
        folders=("mipnerf360", "mip-nerf-360", "mip-nerf360", "360_v2", "360"),
    ),
    "tanksandtemples": Dataset(
        "Tanks and Temples",
        dict.fromkeys(("train", "truck"), ""),
        re.compile(r"\d{5,6}\.jpg"),
        {"train": {(1959, 1090), (980, 545)}, "truck": {(1957, 1091), (979, 546)}},
        folders=("tanksandtemples", "tanks_and_temples", "tandt"),
    ),
    "nerf_synthetic": Dataset(
        "NeRF-Synthetic",
        dict.fromkeys(_OBJECTS, ""),
        re.compile(r"r_\d+\.png"),
        {"": {(800, 800), (400, 400)}},
        masked=True,
        background=WHITE,
        folders=("nerf_synthetic", "nerf-synthetic"),
        views=(100, 200),
        layouts=("blender",),
    ),
    "dtu": Dataset(
        "DTU",
        {f"scan{number}": "" for number in _SCANS},
        re.compile(r"\d{3,6}\.(png|jpg)"),
        {"": {(1600, 1200), (1554, 1162)}},
        masked=True,
        background=WHITE,
        folders=("dtu",),
        layouts=("colmap", "neus"),
    ),
}
# Maximum difference in pixels between a recorded side and the published side. The difference comes from
# rounding.
_ROUNDING = 1


def name_datasets(layout: Layout, name: str, above: str) -> Iterator[tuple[str, bool]]:
    """Yield the datasets that match the scene's name or `above`, the name of the parent folder.

    The flag is true if the name of the parent folder suggests the dataset. The name of the parent folder
    takes precedence over the name of the scene.
    """
    for key, dataset in DATASETS.items():
        if above.lower() in dataset.folders:
            yield key, True
    for key, dataset in DATASETS.items():
        if name in dataset.scenes and layout in dataset.layouts:
            yield key, False


def is_published(
    key: str, scene: str, photographs: Iterable[str], sizes: Iterable[tuple[int, int]], *, below: bool
) -> bool:
    """Return whether photographs have the published names and recorded sizes of a dataset.

    Set `below` if the parent folder has the name of the dataset. If the name of the parent folder matches,
    only the names of the photographs are compared. Resized copies of the photographs are then recognised.
    Folders of DTU's scenes are called scan1 to scan128.
    """
    dataset = DATASETS[key]
    if not all(dataset.names.fullmatch(name.rsplit("/", 1)[-1]) for name in photographs):
        return False
    if below:
        return key != "dtu" or re.fullmatch(r"scan\d{1,3}", scene) is not None
    published = dataset.sizes.get(scene, dataset.sizes.get("", set()))
    return all(
        any(abs(w - width) <= _ROUNDING and abs(h - height) <= _ROUNDING for w, h in published)
        for width, height in sizes
    )
