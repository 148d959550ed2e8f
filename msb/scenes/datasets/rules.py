"""Plain data: which photographs each loader takes, at which size, through which camera, over which colour.

"ours" is the benchmark's one rule for all methods; the others are what the methods' official code does, as
each declares it (`msb.registry`), so that a deviation can be shown, and undone where official numbers are to
be reproduced. docs/datasets.md prints this as a table.

A `resolution` is what the 3DGS family takes as ``-r``: 1, 2, 4 or 8 divide the size, -1 leaves all but very
large photographs alone, any other number is a width in pixels.
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
# Size in pixels to which larger photographs are reduced if no resolution is asked for.
LARGEST = 1600
_DIVISORS = (1, 2, 4, 8)


@dataclass(frozen=True)
class Photographs:
    """The photographs of a dataset: which files are taken, and what is done to them.

    Attributes
    ----------
    folder : str
        The folder below the scene; "." if the names already lead to the files (NeRF-Synthetic).
    resolution : int
    compositing : Compositing
        When a masked photograph is laid over the background; "none" drops the mask.
    instead : (str, int), optional
        The folder and divisor to take if `folder` does not exist; the size is then that of the shipped
        folder.
    """

    folder: str = "images"
    resolution: int = AS_IS
    compositing: Compositing = "none"
    instead: tuple[str, int] | None = None


@dataclass(frozen=True)
class Rules:
    """How one loader reads datasets.

    Attributes
    ----------
    title, source : str
        The name of the rules' owner, and their source (owner/repo: path).
    convention : Convention
        The camera the method is trained with. "gs_fov": angles of view as recorded, the principal point in
        the middle. "full_K": the recorded principal point.
    rounding : Rounding
    resampling : {"bicubic", "bilinear"}
        Pillow's filters, both antialiased.
    first_lens : bool
        Whether the intrinsics of the file's first image are used for all images.
    order : {"stem", "name"}
        The key by which views are sorted before every eighth is taken for testing.
    quantized : bool
        Whether the ground truth is rounded to 8 bits before it is compared.
    photographs : mapping
        Dataset, or dataset/group -> `Photographs`. If a dataset is absent, the code has no rule for it.
    backgrounds : mapping
        Dataset -> colour behind the model in the method's own evaluation; "" stands for all other datasets.
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
        """Return the rule for a dataset's scenes of a group, None if there is none."""
        key = dataset if dataset in DATASETS else CUSTOM
        return self.photographs.get(f"{key}/{group}") or self.photographs.get(key)

    def background_of(self, dataset: str) -> Color:
        """Return the colour behind the model in the method's own evaluation on a dataset."""
        return self.backgrounds.get(dataset, self.backgrounds[""])


# The photographs that all code derived from 3DGS takes.
FAMILY: Mapping[str, Photographs] = {
    "mipnerf360/outdoor": Photographs("images_4"),
    "mipnerf360/indoor": Photographs("images_2"),
    "tanksandtemples": Photographs(),
    "nerf_synthetic": Photographs(".", compositing="before_resize"),
    "dtu": Photographs(resolution=2),
    CUSTOM: Photographs(),
}

# Those it takes where its scripts name no folder: of Mip-NeRF 360 the originals, reduced to `LARGEST`.
FULL_SIZE: Mapping[str, Photographs] = {
    **FAMILY,
    "mipnerf360/outdoor": Photographs(),
    "mipnerf360/indoor": Photographs(),
}


def check_resolution(resolution: int) -> int:
    """Return `resolution` if it is a valid one."""
    if not (resolution == AS_IS or 1 <= resolution <= MAX_SIDE):
        text = (
            f"the resolution is {shorten(repr(resolution), 40)}; it must be 1, 2, 4 or 8, which divide, "
            "-1, as is, or a width in pixels"
        )
        raise SceneError("SCENE_ARGUMENT", text)
    return resolution


def half_even(size: Size, resolution: int) -> Size:
    """Return the size the 3DGS family, Triangle-Splatting, MeshSplatting and 2DGS resize to.

    Divided sides are rounded half to even, others cut off. Only a width above `LARGEST` is reduced at -1.

    Source: `graphdeco-inria/gaussian-splatting`: utils/camera_utils.py (`loadCam`).
    """
    width, height = size
    if resolution in _DIVISORS:
        return round(width / resolution), round(height / resolution)
    if resolution == AS_IS and width <= LARGEST:
        return size
    scale = width / (LARGEST if resolution == AS_IS else resolution)
    return int(width / scale), int(height / scale)  # 1601 / (1601 / 1600) is a little less than 1600


def floor(size: Size, resolution: int) -> Size:
    """Return the size 2DTS resizes to: sides cut off; at -1 the longer side is at most `LARGEST`.

    Source: `GaodeRender/triangle-splatting`: the datasets' `target_res`. It has no widths; the family's rule
    stands in for them.
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
    """Return the size of the folders images_2, images_4 and images_8 as Mip-NeRF 360 ships them.

    Divided sides are rounded half up (`nerfbaselines/nerfbaselines`: its Mip-NeRF 360 loader); otherwise
    as `half_even`.
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
