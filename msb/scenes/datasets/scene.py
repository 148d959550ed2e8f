"""A scene of a dataset, once read: cameras at the size evaluated, and facts about their photographs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from msb.errors import Finding
from msb.scenes.camera import Camera
from msb.scenes.colors import Color
from msb.scenes.datasets.catalog import Layout
from msb.scenes.datasets.rules import Compositing, Convention

MaskSource = Literal["png_alpha", "mask_folder"]


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene of a dataset under one set of rules. `msb.metrics.ground_truth` makes its photographs.

    Attributes
    ----------
    dataset, name : str
        Names as in result records, such as "mipnerf360" and "garden".
    rules : str
        The rules by which it was read; a key of `RULES`.
    image_folder : str
        The folder below `root`; "." if the names of the cameras already lead to the files.
    resolution : int
        The resolution, with the meaning of ``-r`` in the 3DGS family.
    train, test : tuple of Camera
        The cameras at the size evaluated, sorted as the rules say. They have `name` (unique within the
        scene), `image_path`, `split`, and `source_size` if the intrinsics were recorded for another size.
    background : (float, float, float)
        The colour behind the model, and behind a masked photograph.
    mask_source : {"png_alpha", "mask_folder"}, optional
        Where the masks of the photographs are; None if there are none, or they are not used.
    masks : mapping of str to Path
        Name of a camera -> the file of its mask, for "mask_folder".
    resampling : {"bicubic", "bilinear"}
        The filter with which photographs are resized.
    quantized : bool
        Whether the ground truth is rounded to 8 bits before it is compared.
    gt_resized : bool
        Whether a photograph is stored in another size than the one evaluated.
    """

    dataset: str
    name: str
    root: Path
    layout: Layout
    rules: str
    image_folder: str
    resolution: int
    train: tuple[Camera, ...]
    test: tuple[Camera, ...]
    background: Color
    camera_convention: Convention
    compositing: Compositing
    mask_source: MaskSource | None = None
    masks: Mapping[str, Path] = field(default_factory=dict)
    resampling: Literal["bicubic", "bilinear"] = "bicubic"
    quantized: bool = True
    gt_resized: bool = False
    warnings: tuple[Finding, ...] = ()
