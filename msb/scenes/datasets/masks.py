"""Where the masks of photographs are: in their alpha channel, or in a folder of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msb.errors import SceneError, shorten
from msb.scenes.datasets.catalog import DATASETS
from msb.scenes.datasets.layout import images_in
from msb.scenes.image_size import has_alpha, image_size

if TYPE_CHECKING:
    from msb.scenes.camera import Camera
    from msb.scenes.datasets.scene import MaskSource

MASKS = "mask"
"""The mask folder of DTU in the packages of 2DGS and NeuS: one image per photograph, paired by their sorted
order."""


def find_masks(
    root: Path, dataset: str, views: Sequence[Camera]
) -> tuple[MaskSource | None, Mapping[str, Path]]:
    """Return where the masks of test photographs are, and the files of a mask folder by camera name.

    An alpha channel is taken before a folder. A capture that is not one of the masked datasets may have
    neither.
    """
    tests = {str(view.name): view.image_path for view in views if view.split == "test" and view.image_path}
    bare = [name for name, path in tests.items() if not has_alpha(path)]
    if not bare:
        return "png_alpha", {}
    masked = dataset in DATASETS and DATASETS[dataset].masked
    files = images_in(root / MASKS) if dataset == "dtu" else []
    if len(bare) == len(tests) and files:
        return "mask_folder", _paired(root, tests, files)
    if masked or len(bare) < len(tests):
        text = (
            f"{len(bare)} of {len(tests)} test photographs have no alpha channel, "
            f"{shorten(bare[0], 60)} for one; they must be RGBA PNG"
        )
        text += f", or have masks in a folder {MASKS}" if dataset == "dtu" else ""
        raise SceneError("SCENE_IMAGE", text, file=root)
    return None, {}


def _paired(root: Path, photographs: Mapping[str, Path], masks: Sequence[Path]) -> dict[str, Path]:
    """Return the mask of each photograph by its name: that of the same number in the sorted folder."""
    folder = next(iter(photographs.values())).parent
    number = {image: index for index, image in enumerate(images_in(folder))}
    if len(number) != len(masks) or not number.keys() >= set(photographs.values()):
        text = f"there are {len(masks)} masks in it for {len(number)} photographs in {folder.name}"
        raise SceneError("SCENE_IMAGE", text, file=root / MASKS)
    found = {name: masks[number[image]] for name, image in photographs.items()}
    for name, mask in found.items():
        size, wanted = image_size(mask), image_size(photographs[name])
        if size != wanted:
            text = f"it is {size[0]} x {size[1]} pixels, its photograph {wanted[0]} x {wanted[1]}"
            raise SceneError("SCENE_IMAGE", text, file=mask)
    return found
