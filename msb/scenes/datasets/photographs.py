"""The photographs of a scene: which files are used, their sizes, and their masks."""

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

# Folder of masks in the DTU packages of 2DGS and NeuS: one image per photograph, in the same sorted order.
MASKS = "mask"
# Tolerated difference in pixels between the heights of a photograph and its camera, scaled to equal width.
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
    """Return which photographs of the scene at `root` are used, and how their size is rounded.

    The rules give the defaults, and the caller's arguments replace them. Another folder can take the place of
    a missing one. Notes for the user are appended to `warnings`.
    """
    # Rule of the dataset and, for Mip-NeRF 360, of the group of scenes. Unknown scenes use the rule of the
    # first group.
    group = ""
    if dataset in DATASETS:
        scenes = DATASETS[dataset].scenes
        if name not in scenes:
            text = f"{shorten(name, 60)} is not one of the {len(scenes)} {DATASETS[dataset].title} scenes; "
            text += f"the settings of {next(iter(scenes))} are used"
            warnings.append(finding("SCENE_UNKNOWN", text, severity="warning", file=str(root)))
        group = scenes.get(name, next(iter(scenes.values())))
    rule = rules.photographs_of(dataset, group)
    if rule is None:
        text = f"the official code of {rules.title} does not support the dataset {dataset}; use our rules"
        raise SceneError("SCENE_UNKNOWN", text, file=root)
    # Paths in a JSON file are relative to the file's folder.
    folder = image_folder or ("." if layout in ("blender", "transforms") else rule.folder)
    rounding = rules.rounding
    wanted = rule.resolution if resolution is None else resolution
    # If the folder is missing, the rules may name another one and a divisor for it.
    if not is_folder(root / folder):
        if image_folder is not None or rule.instead is None or not is_folder(root / rule.instead[0]):
            raise _missing_folder(root, folder)
        folder = rule.instead[0]
        if resolution is None:
            wanted, rounding = rule.instead[1], "half_up"
        text = f"{rule.folder} is missing; {folder} is resized instead, which changes PSNR by up to 0.5 dB"
        warnings.append(finding("SCENE_IMAGE_RESIZED", text, severity="warning", file=str(root)))
    return replace(rule, folder=folder, resolution=wanted), rounding


def _missing_folder(root: Path, folder: str) -> SceneError:
    """Return the error about a missing folder of photographs, with the names of existing ones."""
    existing = [child.name for child in folders(root) if images_in(child)]
    text = f"photographs are expected in {shorten(folder, 60)}, which does not exist"
    if existing:
        text += f"; choose one of {', '.join(map(shorten, existing[:8]))} "
        text += "(--image-folder, or image_folder in Python and protocols)"
    return SceneError("SCENE_IMAGE_MISSING", text, file=root)


def photograph_sizes(root: Path, views: Sequence[Camera], warnings: list[Finding]) -> list[Size]:
    """Return the stored (width, height) of each view's photograph.

    Cameras with equal recorded sizes must have photographs of equal size. A missing training photograph is
    assumed to have the same size. Test photographs must exist.
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
                f"it has {size[0]} x {size[1]} pixels, but {shorten(str(first.name))} has "
                f"{known[0]} x {known[1]}; photographs of one camera must have one size"
            )
            raise SceneError("SCENE_IMAGE", text, file=view.image_path)
    # A missing photograph is an error if the view is a test view, or if no camera of the same recorded size
    # has a photograph. Otherwise a missing photograph is a warning.
    if missing:
        needed = [view for view in missing if view.split == "test" or (view.width, view.height) not in sizes]
        reported = needed or missing
        names = ", ".join(shorten(str(view.name), 60) for view in reported[:4])
        text = f"{_count_by_split(missing, views)} are missing: {names}"
        text += ", ..." if len(missing) > len(reported[:4]) else ""
        folder = root if reported[0].image_path is None else reported[0].image_path.parent
        if needed:
            raise SceneError("SCENE_IMAGE_MISSING", text, file=folder)
        warnings.append(finding("SCENE_IMAGE_MISSING", text, severity="warning", file=str(folder)))
    # Compare the aspect ratios of photographs and cameras.
    for (width, height), (size, first) in sizes.items():
        expected = height * size[0] / width
        if abs(size[1] - expected) > _ROUNDED_AWAY:
            text = (
                f"it has {size[0]} x {size[1]} pixels, but its camera {width} x {height}, another aspect "
                "ratio; the recorded angles of view are kept"
            )
            warnings.append(finding("SCENE_IMAGE", text, severity="warning", file=str(first.image_path)))
    return [sizes[view.width, view.height][0] for view in views]


def count_missing(views: Sequence[Camera]) -> dict[str, int]:
    """Return how many photographs of training views and of test views are missing."""
    missing = [view.split for view in views if view.image_path is None or not is_file(view.image_path)]
    return {"training": len(missing) - missing.count("test"), "test": missing.count("test")}


def _count_by_split(missing: Sequence[Camera], views: Sequence[Camera]) -> str:
    """Return "1 of 9 test and 16 of 58 training photographs"; a complete split is left out."""
    parts = []
    for split, title in (("test", "test"), ("train", "training")):
        count, total = (sum(view.split == split for view in some) for some in (missing, views))
        parts += [f"{count} of {total} {title}"] if count else []
    return f"{' and '.join(parts)} photographs"


def find_masks(
    root: Path, dataset: str, views: Sequence[Camera]
) -> tuple[MaskSource | None, Mapping[str, Path]]:
    """Return the kind of masks of the test photographs and, for a mask folder, the file of each camera.

    An alpha channel takes precedence over a folder. Captures outside the masked datasets may have neither an
    alpha channel nor a folder of masks.
    """
    tests = {str(view.name): view.image_path for view in views if view.split == "test" and view.image_path}
    bare = [name for name, path in tests.items() if not has_alpha(path)]
    if not bare:
        return "png_alpha", {}
    masked = dataset in DATASETS and DATASETS[dataset].masked
    files = images_in(root / MASKS) if dataset == "dtu" else []
    if len(bare) == len(tests) and files:
        return "mask_folder", _pair_masks(root, tests, files)
    if masked or len(bare) < len(tests):
        text = (
            f"{len(bare)} of {len(tests)} test photographs have no alpha channel, for example "
            f"{shorten(bare[0], 60)}; they must be RGBA PNG"
        )
        text += f", or have masks in a folder {MASKS}" if dataset == "dtu" else ""
        raise SceneError("SCENE_IMAGE", text, file=root)
    return None, {}


def find_mask(root: Path, photograph: Path) -> Path:
    """Return the mask of a photograph (also of a training view) in the mask folder of the scene at `root`.

    Raises
    ------
    SceneError
        SCENE_IMAGE: the numbers of masks and photographs differ, or the mask has another size.
    """
    name = photograph.name
    return _pair_masks(root, {name: photograph}, images_in(root / MASKS))[name]


def _pair_masks(root: Path, photographs: Mapping[str, Path], masks: Sequence[Path]) -> dict[str, Path]:
    """Return the mask of each camera by name; photographs and masks have the same order when sorted."""
    folder = next(iter(photographs.values())).parent
    number = {image: index for index, image in enumerate(images_in(folder))}
    if len(number) != len(masks) or not number.keys() >= set(photographs.values()):
        text = f"it has {len(masks)} masks for {len(number)} photographs in {folder.name}"
        raise SceneError("SCENE_IMAGE", text, file=root / MASKS)
    paired = {name: masks[number[image]] for name, image in photographs.items()}
    for name, mask in paired.items():
        size, wanted = image_size(mask), image_size(photographs[name])
        if size != wanted:
            text = f"it has {size[0]} x {size[1]} pixels, but its photograph has {wanted[0]} x {wanted[1]}"
            raise SceneError("SCENE_IMAGE", text, file=mask)
    return paired
