"""Which photographs of a scene count, how large they are, and where their masks are."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from msb.base.files import is_file, is_folder
from msb.errors import Finding, SceneError, finding, shorten
from msb.scenes.camera import Camera
from msb.scenes.datasets.catalog import DATASETS, Layout
from msb.scenes.datasets.layout import folders, images_in
from msb.scenes.datasets.rules import Photographs, Rounding, Rules, Size
from msb.scenes.datasets.scene import MaskSource
from msb.scenes.image_size import has_alpha, image_size

# The mask folder of DTU in the packages of 2DGS and NeuS: one image per photograph, paired by their sorted
# order.
MASKS = "mask"
# Pixels by which a photograph's height may differ from its camera's at the same width.
_ROUNDED_AWAY = 1.5


def choose_photographs(
    root: Path,
    dataset: str,
    layout: Layout,
    name: str,
    rules: Rules,
    image_folder: str | None,
    resolution: int | None,
    warnings: list[Finding],
) -> tuple[Photographs, Rounding]:
    """Return which photographs of the scene at `root` count, and how their size is rounded.

    They are those of the rules, with the user's wishes and what exists. What should be known is added to
    `warnings`.
    """
    group = ""
    if dataset in DATASETS:
        scenes = DATASETS[dataset].scenes
        if name not in scenes:
            text = f"{shorten(name, 60)} is none of the {len(scenes)} scenes of {DATASETS[dataset].title}: "
            text += f"it is read as {next(iter(scenes))} is"
            warnings.append(finding("SCENE_UNKNOWN", text, severity="warning", file=str(root)))
        group = scenes.get(name, next(iter(scenes.values())))
    rule = rules.photographs_of(dataset, group)
    if rule is None:
        text = f"the official code of {rules.title} has no rule for the dataset {dataset}; read it by ours"
        raise SceneError("SCENE_UNKNOWN", text, file=root)
    # In a JSON file names lead from its own folder to the photographs.
    folder = image_folder or ("." if layout in ("blender", "transforms") else rule.folder)
    rounding = rules.rounding
    wanted = rule.resolution if resolution is None else resolution
    if not is_folder(root / folder):
        if image_folder is not None or rule.instead is None or not is_folder(root / rule.instead[0]):
            raise _no_folder(root, folder)
        folder = rule.instead[0]
        if resolution is None:
            wanted, rounding = rule.instead[1], "half_up"
        text = f"{rule.folder} is not there; {folder} is resized instead, which changes PSNR by up to 0.5 dB"
        warnings.append(finding("SCENE_IMAGE_RESIZED", text, severity="warning", file=str(root)))
    return replace(rule, folder=folder, resolution=wanted), rounding


def _no_folder(root: Path, folder: str) -> SceneError:
    there = [child.name for child in folders(root) if images_in(child)]
    text = f"the photographs are to be taken from {shorten(folder, 60)}, which is not there"
    if there:
        text += f"; there is {', '.join(map(shorten, there[:8]))}: name one of these "
        text += "(--image-folder, or image_folder in Python and protocols)"
    return SceneError("SCENE_IMAGE_MISSING", text, file=root)


def photograph_sizes(root: Path, views: Sequence[Camera], warnings: list[Finding]) -> list[Size]:
    """Return (width, height) of each view's photograph as stored.

    Photographs of cameras recorded with one size must have one size. A training photograph that is missing
    counts as large as those; a test photograph must be there.
    """
    sizes: dict[Size, tuple[Size, Camera]] = {}
    missing: list[Camera] = []
    for view in views:
        if view.image_path is None or not is_file(view.image_path):
            missing.append(view)
            continue
        size, record = image_size(view.image_path), (view.width, view.height)
        known, first = sizes.setdefault(record, (size, view))
        if known != size:
            text = (
                f"it is {size[0]} x {size[1]} pixels, {shorten(str(first.name))} {known[0]} x {known[1]}; "
                "photographs of one camera have one size"
            )
            raise SceneError("SCENE_IMAGE", text, file=view.image_path)
    if missing:
        needed = [view for view in missing if view.split == "test" or (view.width, view.height) not in sizes]
        shown = needed or missing
        names = ", ".join(shorten(str(view.name), 60) for view in shown[:4])
        text = f"{len(shown)} of {len(views)} photographs are not there: {names}"
        text += ", ..." if len(shown) > 4 else ""
        folder = root if shown[0].image_path is None else shown[0].image_path.parent
        if needed:
            raise SceneError("SCENE_IMAGE_MISSING", text, file=folder)
        warnings.append(finding("SCENE_IMAGE_MISSING", text, severity="warning", file=str(folder)))
    for (width, height), (size, first) in sizes.items():
        expected = height * size[0] / width
        if abs(size[1] - expected) > _ROUNDED_AWAY:
            text = (
                f"it is {size[0]} x {size[1]} pixels, its camera {width} x {height}, another shape; "
                "the recorded angles of view are kept"
            )
            warnings.append(finding("SCENE_IMAGE", text, severity="warning", file=str(first.image_path)))
    return [sizes[view.width, view.height][0] for view in views]


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


def mask_beside(root: Path, photograph: Path) -> Path:
    """Return the mask of a photograph, of a training view as well, in the mask folder of the scene at `root`.

    Raises
    ------
    SceneError
        SCENE_IMAGE: there are not as many masks as photographs, or it does not have the size of its own.
    """
    name = photograph.name
    return _paired(root, {name: photograph}, images_in(root / MASKS))[name]


def _paired(root: Path, photographs: Mapping[str, Path], masks: Sequence[Path]) -> dict[str, Path]:
    """Return the mask of each photograph by its name: that of the same number in the sorted folder."""
    folder = next(iter(photographs.values())).parent
    number = {image: index for index, image in enumerate(images_in(folder))}
    if len(number) != len(masks) or not number.keys() >= set(photographs.values()):
        text = f"there are {len(masks)} masks in it for {len(number)} photographs in {folder.name}"
        raise SceneError("SCENE_IMAGE", text, file=root / MASKS)
    paired = {name: masks[number[image]] for name, image in photographs.items()}
    for name, mask in paired.items():
        size, wanted = image_size(mask), image_size(photographs[name])
        if size != wanted:
            text = f"it is {size[0]} x {size[1]} pixels, its photograph {wanted[0]} x {wanted[1]}"
            raise SceneError("SCENE_IMAGE", text, file=mask)
    return paired
