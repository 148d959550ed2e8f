"""Rules for reading scenes: the choice of photographs, image sizes, cameras and backgrounds.

The rules called "ours" apply to all methods of the benchmark. All other rules describe the official code of a
method. The package of the method declares these rules (`msb.registry`). The rules of official code are used
to list deviations and to reproduce published numbers. The page docs/datasets.md prints all rules as a table.

A `resolution` has the meaning of ``-r`` in the 3DGS family. The values 1, 2, 4 and 8 divide the size, and -1
reduces only very large photographs. Any other number is a width in pixels.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from msb.errors import SceneError, shorten
from msb.scenes.checks import MAX_SIDE
from msb.scenes.colors import BLACK, Color
from msb.scenes.datasets.catalog import CUSTOM, DATASETS

Convention = Literal["gs_fov", "full_K"]
CONVENTIONS: tuple[Convention, ...] = ("gs_fov", "full_K")
Compositing = Literal["before_resize", "after_resize", "none"]
# Width and height of an image in pixels.
Size = tuple[int, int]
Rounding = Literal["half_even", "floor", "half_up"]
AS_IS = -1
# If no resolution is requested, larger photographs are reduced to this width in pixels.
LARGEST = 1600
_DIVISORS = (1, 2, 4, 8)


@dataclass(frozen=True)
class Photographs:
    """The photographs of a dataset: the files that are used, and their processing.

    Attributes
    ----------
    folder : str
        The folder below the scene. The value is "." if the names already contain the folder (NeRF-Synthetic).
    resolution : int
    compositing : Compositing
        Whether a masked photograph is composited over the background before or after resizing. The value
        "none" means that the mask is ignored.
    instead : (str, int), optional
        The folder and divisor that are used if `folder` does not exist. Sizes are rounded in the same way as
        in the published folder.
    divided_size : (int, int), optional
        The size of the published photographs after the division. A photograph that already has this size is
        not resized.
    """

    folder: str = "images"
    resolution: int = AS_IS
    compositing: Compositing = "none"
    instead: tuple[str, int] | None = None
    divided_size: Size | None = None


@dataclass(frozen=True)
class Rules:
    """The rules of one loader for reading datasets.

    Attributes
    ----------
    title, source : str
        The loader's name, and the source of its rules (owner/repo: path).
    convention : Convention
        The camera convention of the method's training. "gs_fov" uses the recorded angles of view and a
        principal point in the middle. "full_K" uses the recorded principal point.
    rounding : Rounding
    resampling : {"bicubic", "bilinear"}
        Pillow's resampling filters, both antialiased.
    first_lens : bool
        Whether the intrinsics of the file's first image are used for all images.
    order : {"stem", "name"}
        The sort key of views. Every eighth view in this order is a test view.
    quantized : bool
        Whether the ground truth is rounded to 8 bits before it is compared.
    photographs : mapping
        The rule for photographs (`Photographs`) of each dataset, or of each dataset and group
        ("dataset/group"). Datasets without an entry are not supported by the loader.
    backgrounds : mapping
        For each dataset, the background of the model in the method's official evaluation. The key "" is used
        for all other datasets.
    """

    title: str
    source: str
    convention: Convention = "gs_fov"
    rounding: Rounding = "half_even"
    resampling: Literal["bicubic", "bilinear"] = "bicubic"
    first_lens: bool = False
    order: Literal["stem", "name"] = "stem"
    quantized: bool = True
    photographs: Mapping[str, Photographs] = field(default_factory=dict)
    backgrounds: Mapping[str, Color] = field(default_factory=lambda: {"": BLACK})

    def photographs_of(self, dataset: str, group: str = "") -> Photographs | None:
        """Return the rule for the photographs of a dataset, or of a group of its scenes.

        If the loader does not support the dataset, the result is None.
        """
        key = dataset if dataset in DATASETS else CUSTOM
        return self.photographs.get(f"{key}/{group}") or self.photographs.get(key)

    def background_of(self, dataset: str) -> Color:
        """Return the background in the method's official evaluation on a dataset."""
        return self.backgrounds.get(dataset, self.backgrounds[""])


# Photographs used by all code derived from 3DGS, for each dataset.
FAMILY: Mapping[str, Photographs] = {
    "mipnerf360/outdoor": Photographs("images_4"),
    "mipnerf360/indoor": Photographs("images_2"),
    "tanksandtemples": Photographs(),
    "nerf_synthetic": Photographs(".", compositing="before_resize"),
    "dtu": Photographs(resolution=2),
    CUSTOM: Photographs(),
}

# Photographs that are used if a script of code derived from 3DGS names no folder. For Mip-NeRF 360, the
# original photographs are reduced to `LARGEST`.
FULL_SIZE: Mapping[str, Photographs] = {
    **FAMILY,
    "mipnerf360/outdoor": Photographs(),
    "mipnerf360/indoor": Photographs(),
}


def check_resolution(resolution: int) -> int:
    """If `resolution` is valid, return it."""
    if not (resolution == AS_IS or 1 <= resolution <= MAX_SIDE):
        text = (
            f"the resolution is {shorten(repr(resolution), 40)}; it must be 1, 2, 4 or 8 (divide the size), "
            "-1 (keep it), or a width in pixels"
        )
        raise SceneError("SCENE_ARGUMENT", text)
    return resolution


def half_even(size: Size, resolution: int) -> Size:
    """Return the image size after resizing in the 3DGS family, Triangle-Splatting, MeshSplatting and 2DGS.

    For the resolutions 2, 4 and 8, sides are rounded to whole pixels, and halves are rounded to even. If a
    width is requested, fractions of a pixel are truncated. At resolution -1, only photographs wider than
    `LARGEST` are reduced.

    Source: `graphdeco-inria/gaussian-splatting`: utils/camera_utils.py (`loadCam`).
    """
    width, height = size
    if resolution in _DIVISORS:
        return round(width / resolution), round(height / resolution)
    if resolution == AS_IS and width <= LARGEST:
        return size
    scale = width / (LARGEST if resolution == AS_IS else resolution)
    return int(width / scale), int(height / scale)  # 1601 / (1601 / 1600) is slightly less than 1600


def floor(size: Size, resolution: int) -> Size:
    """Return the image size after resizing in 2DTS.

    Sides are truncated. At resolution -1, the longer side is at most `LARGEST`.

    Source: `GaodeRender/triangle-splatting`: the datasets' `target_res`. The official code of 2DTS does not
    support a requested width, so the rule of the 3DGS family is used.
    """
    width, height = size
    if resolution in _DIVISORS:
        return width // resolution, height // resolution
    if resolution != AS_IS:
        return half_even(size, resolution)
    longest = max(size)
    if longest <= LARGEST:
        return size
    return width * LARGEST // longest, height * LARGEST // longest


def half_up(size: Size, resolution: int) -> Size:
    """Return the image size in the folders images_2, images_4 and images_8 as published with Mip-NeRF 360.

    Divided sides are rounded to whole pixels, and halves are rounded up (`nerfbaselines/nerfbaselines`: its
    Mip-NeRF 360 loader). For all other resolutions, the function returns the result of `half_even`.
    """
    if resolution not in _DIVISORS:
        return half_even(size, resolution)
    width, height = (math.floor(side / resolution + 0.5) for side in size)
    return width, height


ROUNDINGS: dict[Rounding, Callable[[Size, int], Size]] = {
    "half_even": half_even,
    "floor": floor,
    "half_up": half_up,
}
