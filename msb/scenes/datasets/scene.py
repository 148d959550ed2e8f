"""What a scene of a dataset is, once read: cameras at the size evaluated, and what their photographs are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from msb.errors import Finding
    from msb.scenes.camera import Camera
    from msb.scenes.colors import Color
    from msb.scenes.datasets.catalog import Layout
    from msb.scenes.datasets.rules import Compositing, Convention

MaskSource = Literal["png_alpha", "mask_folder"]


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene of a dataset under one set of rules. `msb.bench.ground_truth` makes its photographs.

    Attributes
    ----------
    dataset, name : str
        As in result records: "mipnerf360", "garden".
    root : Path
        The scene's folder.
    layout : Layout
    rules : str
        Whose rules it was read by; a key of `RULES`.
    image_folder : str
        Below `root`; "." where the names of the cameras already lead to the files.
    resolution : int
        As ``-r`` of the 3DGS family.
    train, test : tuple of Camera
        At the size evaluated, with `name` (unique within the scene), `image_path`, `split`, and
        `source_size` where the intrinsics were recorded for another size. Sorted as the rules say.
    background : (float, float, float)
        Behind the model, and behind a masked photograph.
    camera_convention : {"gs_fov", "full_K"}
    compositing : {"before_resize", "after_resize", "none"}
    mask_source : {"png_alpha", "mask_folder"}, optional
        Where the masks of the photographs are; None: there are none, or they do not count.
    masks : mapping of str to Path
        Name of a camera -> its file, for "mask_folder".
    resampling : {"bicubic", "bilinear"}
        Of photographs that are resized.
    quantized : bool
        The ground truth is rounded to 8 bits before it is compared.
    gt_resized : bool
        A photograph is stored in another size than it is evaluated in.
    warnings : tuple of Finding
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
