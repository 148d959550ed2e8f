"""A scene of a dataset after reading: cameras at the evaluated size, and properties of their photographs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

from msb.errors import Finding
from msb.scenes.camera import Camera
from msb.scenes.colors import Color
from msb.scenes.datasets.catalog import Layout
from msb.scenes.datasets.rules import Compositing, Convention
from msb.scenes.datasets.splits import SplitSource
from msb.scenes.upright import find_up

# Masks are alpha channels of the photographs, files in a mask folder, or files named in transforms.json.
MaskSource = Literal["png_alpha", "mask_folder", "mask_path"]


@dataclass(frozen=True)
class Reading:
    """The steps between a stored photograph and the undistorted image of a pinhole camera, before resizing.

    Attributes
    ----------
    orientation : int
        The EXIF orientation to apply; 1 keeps the pixels as stored.
    lens : Camera, optional
        The camera of the stored photograph, including its lens distortion. The size of this camera is the
        size of the rotated photograph.
    """

    orientation: int = 1
    lens: Camera | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene of a dataset, read by one set of rules.

    `msb.metrics.ground_truth` loads the photographs of the scene.

    Attributes
    ----------
    dataset, name : str
        The names of dataset and scene as in result records, such as "mipnerf360" and "garden".
    rules : str
        The rules that were used for reading, as a key of `RULES`.
    image_folder : str
        The folder of the photographs below `root`. If the cameras' names are paths, the value is ".".
    resolution : int
        The resolution, with the meaning of ``-r`` in the 3DGS family.
    train, test : tuple of Camera
        The cameras at the evaluated size, sorted by the rules. Each camera has a unique `name`, an
        `image_path` and a `split`. If the intrinsics were recorded for another size, the camera also has a
        `source_size`.
    background : (float, float, float)
        The background of renderings of the model and of masked photographs.
    mask_source : {"png_alpha", "mask_folder", "mask_path"}, optional
        The kind of masks that the scene has. The value is None if masks are missing or not used.
    masks : mapping of str to Path
        The mask file of each camera name, for "mask_folder" and "mask_path". A view without a mask file is
        not masked.
    readings : mapping of str to Reading
        The rotation and undistortion of each photograph that needs them. The keys of the mapping are camera
        names.
    lens : Camera, optional
        The first recorded view, before undistortion.
    split : {"recorded", "every 8th", "benchmark"}
        How the test views were chosen.
    missing : mapping
        The numbers of training views and test views without a photograph.
    resampling : {"bicubic", "bilinear"}
        The filter for resizing photographs.
    quantized : bool
        Whether the ground truth is rounded to 8 bits before it is compared.
    gt_resized : bool
        Whether a photograph is stored in another size than the evaluated size.
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
    readings: Mapping[str, Reading] = field(default_factory=dict)
    lens: Camera | None = None
    split: SplitSource = "every 8th"
    missing: Mapping[str, int] = field(default_factory=dict)
    resampling: Literal["bicubic", "bilinear"] = "bicubic"
    quantized: bool = True
    gt_resized: bool = False
    warnings: tuple[Finding, ...] = ()

    @cached_property
    def up(self) -> tuple[float, float, float]:
        """The unit vector that points up in the world of the capture (`find_up`)."""
        x, y, z = find_up([*self.train, *self.test]).tolist()
        return x, y, z
