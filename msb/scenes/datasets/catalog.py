"""The datasets of the benchmark, their scenes and groups of scenes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from msb.scenes.colors import WHITE, Color

# Name of the dataset of a capture that is not in `DATASETS` and for which no name was passed.
CUSTOM = "custom"

# Layout of a scene's folder. "colmap" has sparse/, "blender" has transforms_train.json and
# transforms_test.json, "transforms" has transforms.json without a split, "neus" has cameras.npz.
Layout = Literal["colmap", "blender", "transforms", "neus"]


@dataclass(frozen=True)
class Dataset:
    """A dataset.

    Attributes
    ----------
    title : str
    scenes : mapping of str to str
        Scene -> its group, which is "" in datasets without groups.
    masked : bool
        Whether only the object is evaluated: photographs have a mask and are composited over `background`.
    background : Color, optional
        The background of photographs and renderings; None if it depends on the method (`Rules.backgrounds`).
    folders : tuple of str
        Names, in lower case, of the folder above the scenes in published packages.
    views : (int, int), optional
        The numbers of training and test views, if they are equal for all scenes.
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

# The datasets by id, in the order of the paper's tables.
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


def guess_dataset(layout: Layout, name: str, above: str) -> str:
    """Return the dataset of a scene called `name` in a folder called `above`, or `CUSTOM`.

    The name of the folder above takes precedence. The scene's name is used only if the dataset has the
    layout.
    """
    for key, dataset in DATASETS.items():
        if above.lower() in dataset.folders:
            return key
    fits = {"nerf_synthetic": ("blender",), "dtu": ("colmap", "neus")}
    for key, dataset in DATASETS.items():
        if name in dataset.scenes and layout in fits.get(key, ("colmap",)):
            return key
    return CUSTOM
