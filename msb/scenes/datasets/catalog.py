"""Plain data: the datasets of the benchmark, their scenes and groups of scenes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from msb.scenes.colors import WHITE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from msb.scenes.colors import Color

CUSTOM = "custom"
"""What a capture is called that belongs to none of `DATASETS` and was given no name."""

Layout = Literal["colmap", "blender", "transforms", "neus"]
"""colmap: sparse/. blender: transforms_train.json and transforms_test.json. transforms: transforms.json, with
no split. neus: cameras.npz."""


@dataclass(frozen=True)
class Dataset:
    """One dataset.

    Attributes
    ----------
    title : str
    scenes : mapping of str to str
        Scene -> its group; a dataset without groups has one, "".
    masked : bool
        Only the object counts: photographs bring a mask and are laid over `background`.
    background : Color, optional
        Of photographs and renderings; None where that is the method's own (`Rules.backgrounds`).
    folders : tuple of str
        What the folder above the scenes is called in packages, lower case.
    views : (int, int), optional
        Training and test views a scene has, where that is the same for all.
    """

    title: str
    scenes: Mapping[str, str]
    masked: bool = False
    background: Color | None = None
    folders: tuple[str, ...] = ()
    views: tuple[int, int] | None = None


_INDOOR, _OUTDOOR = (
    ("room", "counter", "kitchen", "bonsai"),
    ("bicycle", "flowers", "garden", "stump", "treehill"),
)
_OBJECTS = ("chair", "drums", "ficus", "hotdog", "lego", "materials", "mic", "ship")
_SCANS = (24, 37, 40, 55, 63, 65, 69, 83, 97, 105, 106, 110, 114, 118, 122)

DATASETS: dict[str, Dataset] = {
    "mipnerf360": Dataset(
        "Mip-NeRF 360",
        dict.fromkeys(_OUTDOOR, "outdoor") | dict.fromkeys(_INDOOR, "indoor"),
        folders=("mipnerf360", "mip-nerf-360", "mip-nerf360", "360_v2", "360"),
    ),
    "tanksandtemples": Dataset(
        "Tanks and Temples",
        dict.fromkeys(("train", "truck"), ""),
        folders=("tanksandtemples", "tanks_and_temples", "tandt"),
    ),
    "nerf_synthetic": Dataset(
        "NeRF-Synthetic",
        dict.fromkeys(_OBJECTS, ""),
        masked=True,
        background=WHITE,
        folders=("nerf_synthetic", "nerf-synthetic"),
        views=(100, 200),
    ),
    "dtu": Dataset(
        "DTU",
        {f"scan{number}": "" for number in _SCANS},
        masked=True,
        background=WHITE,
        folders=("dtu",),
    ),
}
"""Id -> dataset, in the order of the tables."""


def guess_dataset(layout: Layout, name: str, above: str) -> str:
    """Return the dataset of a scene called `name` in a folder called `above`, `CUSTOM` if it is none.

    The folder above decides, then the scene's name together with its layout.
    """
    for key, dataset in DATASETS.items():
        if above.lower() in dataset.folders:
            return key
    fits = {"nerf_synthetic": ("blender",), "dtu": ("colmap", "neus")}
    for key, dataset in DATASETS.items():
        if name in dataset.scenes and layout in fits.get(key, ("colmap",)):
            return key
    return CUSTOM
