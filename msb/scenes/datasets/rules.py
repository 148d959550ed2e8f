"""Rules of loaders: their choice of photographs, image sizes, cameras and backgrounds.

"ours" is the benchmark's rule for all methods. All other rules describe the official code of a method, which
declares them (`msb.registry`). These rules serve to list deviations and to reproduce official numbers.
docs/datasets.md prints the rules as a table.

A `resolution` has the meaning of ``-r`` in the 3DGS family: 1, 2, 4 or 8 divides the size, -1 reduces only
very large photographs, and any other number is a width in pixels.
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
# Width and height in pixels.
Size = tuple[int, int]
Rounding = Literal["half_even", "floor", "half_up"]
AS_IS = -1
# Larger photographs are reduced to this width in pixels if no resolution is requested.
LARGEST = 1600
_DIVISORS = (1, 2, 4, 8)


@dataclass(frozen=True)
class Photographs:
    """The photographs of a dataset: which files are used, and how they are processed.

    Attributes
    ----------
    folder : str
        The folder below the scene; "." if the names are already paths (NeRF-Synthetic).
    resolution : int
    compositing : Compositing
        When a masked photograph is composited over the background; "none" ignores the mask.
    instead : (str, int), optional
        The folder and divisor to use if `folder` does not exist; sizes are then rounded like in the
        published folder.
    divided_size : (int, int), optional
        The size of the published photographs after the division. Copies that already have it are used as
        they are.
    """

    folder: str = "images"
    resolution: int = AS_IS
    compositing: Compositing = "none"
    instead: tuple[str, int] | None = None
    divided_size: Size | None = None


@dataclass(frozen=True)
class Rules:
    """How one loader reads datasets.

    Attributes
    ----------
    title, source : str
        The loader's name, and the source of its rules (owner/repo: path).
    convention : Convention
        The camera the method is trained with. "gs_fov": recorded angles of view, principal point in the
        middle. "full_K": recorded principal point.
    rounding : Rounding
    resampling : {"bicubic", "bilinear"}
        Pillow's filters, both antialiased.
    first_lens : bool
        Whether the intrinsics of the file's first image are used for all images.
    order : {"stem", "name"}
        The sort key of views; every eighth view in this order is a test view.
    quantized : bool
        Whether the ground truth is rounded to 8 bits before it is compared.
    photographs : mapping
        Dataset, or dataset/group -> `Photographs`. The loader does not support datasets without an entry.
    backgrounds : mapping
        Dataset -> background of the model in the method's official evaluation; "" stands for all other
        datasets.
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
        """Return the rule for a group of a dataset's scenes; None if the dataset is not supported."""
        key = dataset if dataset in DATASETS else CUSTOM
        return self.photographs.get(f"{key}/{group}") or self.photographs.get(key)

    def background_of(self, dataset: str) -> Color:
        """Return the background in the method's official evaluation on a dataset."""
        return self.backgrounds.get(dataset, self.backgrounds[""])


# Photographs used by all code derived from 3DGS.
FAMILY: Mapping[str, Photographs] = {
    "mipnerf360/outdoor": Photographs("images_4"),
    "mipnerf360/indoor": Photographs("images_2"),
    "tanksandtemples": Photographs(),
    "nerf_synthetic": Photographs(".", compositing="before_resize"),
    "dtu": Photographs(resolution=2),
    CUSTOM: Photographs(),
}

# Photographs used by such code if its scripts name no folder: for Mip-NeRF 360 the originals, reduced to
# `LARGEST`.
FULL_SIZE: Mapping[str, Photographs] = {
    **FAMILY,
    "mipnerf360/outdoor": Photographs(),
    "mipnerf360/indoor": Photographs(),
}


def check_resolution(resolution: int) -> int:
    """Return `resolution` if it is valid."""
    if not (resolution == AS_IS or 1 <= resolution <= MAX_SIDE):
        text = (
            f"the resolution is {shorten(repr(resolution), 40)}; it must be 1, 2, 4 or 8 (divide the size), "
            "-1 (keep it), or a width in pixels"
        )
        raise SceneError("SCENE_ARGUMENT", text)
    return resolution


def half_even(size: Size, resolution: int) -> Size:
    """Return the size after resizing in the 3DGS family, Triangle-Splatting, MeshSplatting and 2DGS.

    A divided side is rounded half to even. If a width is requested, sides are truncated. At -1 only widths
    above `LARGEST` are reduced.

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
    """Return the size after resizing in 2DTS.

    Sides are truncated. At -1 the longer side is at most `LARGEST`.

    Source: `GaodeRender/triangle-splatting`: the datasets' `target_res`. This method's code does not support
    widths, so widths follow the rule of the 3DGS family.
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
    """Return the size in the folders images_2, images_4 and images_8 as published with Mip-NeRF 360.

    Divided sides are rounded half up (`nerfbaselines/nerfbaselines`: its Mip-NeRF 360 loader); otherwise as
    in `half_even`.
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
