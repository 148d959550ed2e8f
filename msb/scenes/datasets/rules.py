"""Plain data: which photographs each loader takes, at which size, through which camera, over which colour.

"ours" is the benchmark's one rule for all methods; the others are what the methods' official code does, as
each declares it (`msb.registry`), so that a deviation can be shown, and undone where official numbers are to
be reproduced. docs/datasets.md prints this as a table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from msb.scenes.colors import BLACK, Color
from msb.scenes.datasets.catalog import CUSTOM, DATASETS
from msb.scenes.datasets.sizes import AS_IS, Rounding

Convention = Literal["gs_fov", "full_K"]
CONVENTIONS: tuple[Convention, ...] = ("gs_fov", "full_K")
Compositing = Literal["before_resize", "after_resize", "none"]


@dataclass(frozen=True)
class Photographs:
    """The photographs of a dataset: which files are taken, and what is done to them.

    Attributes
    ----------
    folder : str
        The folder below the scene; "." if the names already lead to the files (NeRF-Synthetic).
    resolution : int
        The resolution, with the meaning of ``-r`` in the 3DGS family (`msb.scenes.datasets.sizes`).
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


FAMILY: Mapping[str, Photographs] = {
    "mipnerf360/outdoor": Photographs("images_4"),
    "mipnerf360/indoor": Photographs("images_2"),
    "tanksandtemples": Photographs(),
    "nerf_synthetic": Photographs(".", compositing="before_resize"),
    "dtu": Photographs(resolution=2),
    CUSTOM: Photographs(),
}
"""The photographs that all code derived from 3DGS takes."""
