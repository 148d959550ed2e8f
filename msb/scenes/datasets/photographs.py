"""The photographs of a scene: the files that are used, their sizes, and their masks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from msb.base.files import is_file, is_folder
from msb.base.paths import SpelledFiles, shell_word
from msb.errors import Finding, SceneError, Severity, finding, shorten
from msb.scenes.camera import Camera
from msb.scenes.datasets.catalog import DATASETS, Layout
from msb.scenes.datasets.layout import folders, images_in
from msb.scenes.datasets.rules import Photographs, Rounding, Rules, Size
from msb.scenes.datasets.scene import MaskSource, Reading
from msb.scenes.image_size import ImageHeader, image_size, read_header
from msb.scenes.lenses import undistorted

# Folder of masks in the DTU packages of 2DGS and NeuS. The folder has one image per photograph, in the same
# sorted order.
MASKS = "mask"
# Folder of masks in other captures. Each mask has the name of its photograph.
MASK_FOLDER = "masks"
# Pillow's modes of photographs: 8 bits per channel, with or without alpha.
PHOTOGRAPH_MODES = ("RGB", "RGBA", "L", "LA")
# Image formats that must be converted before use. Each entry has Pillow's name and a readable name.
_OTHER_KINDS = {"WEBP": "WebP", "AVIF": "AVIF", "HEIF": "HEIC"}
# EXIF orientations of at least this value swap width and height.
_FIRST_SWAP = 5
# Maximum number of missing photographs in a message. The second number limits how many similar file names a
# message lists.
_MAX_NAMES, _MAX_HINTS = 4, 2
# Maximum difference in pixels between the heights of a photograph and its camera, after scaling to equal
# width.
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
    """Return which photographs of the scene at `root` are used, and how their sizes are rounded.

    Arguments of the caller replace the defaults of the rules. If the folder of photographs is missing,
    another folder may be used. Notes for the user are appended to `warnings`.
    """
    # Find the rule of the dataset. Mip-NeRF 360 has a rule for each group of scenes. Unknown scenes use the
    # rule of the first group.
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
    # If the folder is missing, the rules may name another folder and a factor by which its images are
    # reduced.
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
    """Return the error about a missing folder of photographs, with the names of existing folders."""
    existing = [child.name for child in folders(root) if images_in(child)]
    text = f"photographs are expected in {shorten(folder, 60)}, which does not exist"
    if existing:
        text += f"; choose one of {', '.join(map(shorten, existing[:8]))} "
        text += "(--image-folder, or image_folder in Python and protocols)"
    return SceneError("SCENE_IMAGE_MISSING", text, file=root)


def locate_photographs(
    root: Path, layout: Layout, views: Sequence[Camera], folder: str, *, is_requested: bool
) -> list[Camera]:
    """Return the views with the paths of their photographs. The files of the photographs may be missing.

    Names of photographs are relative to `folder`. In JSON files, the names of photographs begin with a
    folder. A requested folder such as images_2 replaces the first folder of the name. If the requested folder
    contains a photograph with the full name, the full name is used.
    """
    files = SpelledFiles(root / folder)
    located = [replace(view, image_path=files.find(str(view.name))) for view in views]
    if layout in ("blender", "transforms") and is_requested and not any(map(_has_photograph, located)):
        below = [
            replace(v, image_path=files.find(str(v.name).partition("/")[2] or str(v.name))) for v in views
        ]
        if any(map(_has_photograph, below)):
            return below
    return located


def _has_photograph(view: Camera) -> bool:
    return view.image_path is not None and is_file(view.image_path)


def check_missing(
    root: Path, views: Sequence[Camera], warnings: list[Finding], *, are_left_out: bool
) -> None:
    """Report views without a photograph. If too many photographs are missing, raise an error, otherwise add a
    warning.

    If `are_left_out` is true, a single view with a photograph is sufficient. If `are_left_out` is false, all
    test views must have a photograph. At least one view of each recorded size must also have a photograph.
    """
    missing = [view for view in views if not _has_photograph(view)]
    if not missing:
        return
    sizes = {(view.width, view.height) for view in views if _has_photograph(view)}
    needed = [view for view in missing if view.split == "test" or (view.width, view.height) not in sizes]
    is_error = not sizes if are_left_out else bool(needed)
    reported = needed if is_error and needed else missing
    # The message lists the first missing photographs. Also list files whose name differs from a missing
    # photograph only by suffix or case.
    names = []
    alike = 0
    for number, view in enumerate(reported[:_MAX_NAMES]):
        near = _find_near_miss(view)
        alike += near is not None
        hint = f" ({shorten(near, 60)} exists)" if near is not None and number < _MAX_HINTS else ""
        names.append(f"{shorten(str(view.name), 60)}{hint}")
    more = ", ..." if len(missing) > len(names) else ""
    text = f"{_count_by_split(missing, views)} are missing: {', '.join(names)}{more}"
    text += "; rename the files or the views" if alike else ""
    text += "; these views are left out" if are_left_out and not is_error else ""
    folder = root if reported[0].image_path is None else reported[0].image_path.parent
    if is_error:
        raise SceneError("SCENE_IMAGE_MISSING", text, file=folder)
    warnings.append(finding("SCENE_IMAGE_MISSING", text, severity="warning", file=str(folder)))


def _find_near_miss(view: Camera) -> str | None:
    """Return a file whose name differs from a missing photograph only by suffix or case."""
    assert view.image_path is not None
    wanted = view.image_path
    beside = images_in(wanted.parent)
    same_name = (file.name for file in beside if file.name.casefold() == wanted.name.casefold())
    same_stem = (file.name for file in beside if file.stem.casefold() == wanted.stem.casefold())
    return next(same_name, None) or next(same_stem, None)


@dataclass(frozen=True)
class StoredPhotographs:
    """The photographs of the views: the steps for reading each photograph, and its final size.

    `views` are pinhole cameras. A view has the size of its undistorted photograph. If the photograph is
    missing, the view has the recorded size. `sizes` has an entry for each view. `readings` has an entry only
    for views whose photographs are rotated, undistorted or resized.
    """

    views: list[Camera]
    sizes: list[Size]
    readings: dict[str, Reading]


def inspect_photographs(
    root: Path, views: Sequence[Camera], warnings: list[Finding], *, converts: bool
) -> StoredPhotographs:
    """Read the headers of the photographs, and return how each photograph is read.

    If cameras have equal recorded sizes, their photographs must have equal sizes. A missing photograph gets
    the size of the other photographs. If `converts` is true, image formats that must be converted are
    accepted.
    """
    sizes: dict[Size, tuple[Size, Camera]] = {}
    turned: dict[str, int] = {}
    verdicts: dict[tuple[str, int], list[Camera]] = {}
    for view in views:
        if not _has_photograph(view) or view.image_path is None:
            continue
        header, record = read_header(view.image_path), (view.width, view.height)
        _check_kind(root, view.image_path, header, converts=converts)
        # Apply the EXIF orientation if the recorded size requires it.
        size, verdict = _choose_orientation(header, record)
        if verdict is not None:
            verdicts.setdefault((verdict, header.orientation), []).append(view)
        if verdict == "applied":
            turned[str(view.name)] = header.orientation
        known, first = sizes.setdefault(record, (size, view))
        if known != size:
            text = (
                f"it has {size[0]} x {size[1]} pixels, but {shorten(str(first.name))} has "
                f"{known[0]} x {known[1]}; photographs of one camera must have one size"
            )
            raise SceneError("SCENE_IMAGE", text, file=view.image_path)
    warnings += [_note_orientation(*key, group) for key, group in verdicts.items()]
    # Compare the aspect ratio of each photograph with its camera.
    for record, (size, first) in sizes.items():
        if not _fits(size, record):
            text = (
                f"it has {size[0]} x {size[1]} pixels, but its camera has {record[0]} x {record[1]}; "
                "the aspect ratios differ, and the recorded angles of view are kept"
            )
            warnings.append(finding("SCENE_IMAGE", text, severity="warning", file=str(first.image_path)))
    # An undistorted photograph has the size of its pinhole camera.
    cameras, stored, readings = [], [], {}
    for view in views:
        name, size = str(view.name), sizes[view.width, view.height][0]
        lens = None if view.distortion is None else replace(view.resized(*size), source_size=None)
        if lens is not None or name in turned:
            readings[name] = Reading(turned.get(name, 1), lens)
        cameras.append(view if lens is None else undistorted(lens))
        stored.append(size if lens is None else (cameras[-1].width, cameras[-1].height))
    return StoredPhotographs(cameras, stored, readings)


def _check_kind(root: Path, path: Path, header: ImageHeader, *, converts: bool) -> None:
    """Raise SCENE_IMAGE for an image format that cannot be compared with renderings."""
    if header.mode not in PHOTOGRAPH_MODES:
        text = f"it has the pixel format {header.mode}; convert it to an 8-bit RGB or RGBA image"
        raise SceneError("SCENE_IMAGE", text, file=path)
    kind = "grey" if header.mode in ("L", "LA") else _OTHER_KINDS.get(header.format)
    if kind is not None and not converts:
        name = "grey image" if kind == "grey" else f"{kind} image"
        text = f"it is a {name}; photographs are compared as colour PNG, JPEG or TIFF. Convert them with: "
        raise SceneError("SCENE_IMAGE", f"{text}msb scenes {shell_word(root)} --undistort OUT", file=path)


def _choose_orientation(header: ImageHeader, record: Size) -> tuple[Size, str | None]:
    """Return the final image size of a photograph, and whether its EXIF orientation is applied.

    COLMAP records the size of the stored pixels, before the EXIF orientation is applied. Other programs
    record the image size after applying the EXIF orientation. The decision is "applied", "as stored" or
    "undecided". For a photograph without an orientation, it is None.
    """
    size, turned = header.size, header.size[::-1]
    if header.orientation == 1:
        return size, None
    if header.orientation < _FIRST_SWAP or _fits(size, record) == _fits(turned, record):
        return size, "undecided"
    return (turned, "applied") if _fits(turned, record) else (size, "as stored")


def _fits(size: Size, record: Size) -> bool:
    """Return whether a photograph has the same aspect ratio as its recorded camera."""
    return abs(size[1] - record[1] * size[0] / record[0]) <= _ROUNDED_AWAY


def _note_orientation(verdict: str, orientation: int, views: Sequence[Camera]) -> Finding:
    """Return a note that states whether the EXIF orientation of photographs was applied."""
    count = f"{len(views)} photograph{'s' if len(views) > 1 else ''}"
    width, height = views[0].width, views[0].height
    recorded = f"because the cameras were recorded at {width} x {height} pixels"
    undecided = "is not applied; the recorded camera size does not determine the orientation"
    ends = {"applied": f"is applied, {recorded}", "as stored": f"is not applied, {recorded}"}
    text = f"the EXIF orientation {orientation} of {count} {ends.get(verdict, undecided)}"
    severity: Severity = "warning" if verdict == "undecided" else "info"
    return finding("SCENE_IMAGE", text, severity=severity, file=str(views[0].image_path))


def count_missing(views: Sequence[Camera]) -> dict[str, int]:
    """Return how many photographs of training views and of test views are missing."""
    missing = [view.split for view in views if not _has_photograph(view)]
    return {"training": len(missing) - missing.count("test"), "test": missing.count("test")}


def _count_by_split(missing: Sequence[Camera], views: Sequence[Camera]) -> str:
    """Return a count such as "1 of 9 test and 16 of 58 training photographs".

    If a split has no missing photographs, the text omits the split.
    """
    parts = []
    for split, title in (("test", "test"), ("train", "training")):
        count, total = (sum(view.split == split for view in some) for some in (missing, views))
        parts += [f"{count} of {total} {title}"] if count else []
    return f"{' and '.join(parts)} photographs"


def find_masks(
    root: Path,
    dataset: str,
    views: Sequence[Camera],
    paths: Mapping[str, str],
    image_folder: str,
    warnings: list[Finding],
) -> tuple[MaskSource | None, Mapping[str, Path]]:
    """Return the kind of masks. If the masks are files, also return the file for each camera name.

    An alpha channel takes precedence over mask files. `paths` are the mask files that transforms.json names.
    Only scenes of masked datasets, such as DTU, need masks.
    """
    shot = {str(v.name): v.image_path for v in views if v.image_path is not None and _has_photograph(v)}
    tests = {
        str(view.name): shot[str(view.name)] for view in views if view.split == "test" and view.name in shot
    }
    bare = [name for name, path in tests.items() if not read_header(path).has_alpha]
    if not bare:
        return "png_alpha", {}
    masked = dataset in DATASETS and DATASETS[dataset].masked
    files = images_in(root / MASKS) if dataset == "dtu" else []
    if len(bare) == len(tests) and files:
        return "mask_folder", _pair_masks(root, shot, files)
    if not masked and len(bare) == len(tests):
        return _find_mask_files(root, views, shot, paths, image_folder, warnings)
    text = (
        f"{len(bare)} of {len(tests)} test photographs have no alpha channel, for example "
        f"{shorten(bare[0], 60)}; they must be RGBA PNG"
    )
    text += f", or have masks in a folder {MASKS}" if dataset == "dtu" else ""
    raise SceneError("SCENE_IMAGE", text, file=root)


def _find_mask_files(
    root: Path,
    views: Sequence[Camera],
    shot: Mapping[str, Path],
    paths: Mapping[str, str],
    image_folder: str,
    warnings: list[Finding],
) -> tuple[MaskSource | None, Mapping[str, Path]]:
    """Find the masks of a capture by their names. A few views may have no mask.

    The mask of images/a.jpg is called masks/a.jpg, masks/a.jpg.png (as in COLMAP) or masks/a.png. The mask of
    images_2/a.jpg may also be in masks_2.
    """
    files = SpelledFiles(root)
    masks: dict[str, Path] = {}
    named = {name: files.find(path) for name, path in paths.items() if name in shot}
    source: MaskSource = "mask_path" if any(map(is_file, named.values())) else "mask_folder"
    folders = [image_folder.replace("images", MASK_FOLDER, 1), MASK_FOLDER, MASKS]
    present = [
        folder for folder in dict.fromkeys(folders) if folder != image_folder and is_folder(root / folder)
    ]
    for name, path in shot.items():
        below = name if image_folder != "." else name.partition("/")[2] or name
        spellings = (below, f"{below}.png", str(PurePosixPath(below).with_suffix(".png")))
        places = [files.find(f"{folder}/{spelling}") for folder in present for spelling in spellings]
        candidates = [named[name]] if source == "mask_path" and name in named else places
        mask = next((place for place in candidates if is_file(place) and place != path), None)
        if mask is not None:
            _check_mask(mask, read_header(path).size)
            masks[name] = mask
    if not masks:
        if paths or present:
            what = "the paths mask_path" if paths else f"the files in {', '.join(present)}"
            text = f"no photograph has a mask: {what} do not belong to the photographs"
            warnings.append(finding("SCENE_IMAGE", text, severity="warning", file=str(root)))
        return None, {}
    if lacking := [name for name in shot if name not in masks]:
        text = f"{len(lacking)} of {len(shot)} photographs have no mask and are not masked, for example "
        warnings.append(
            finding("SCENE_IMAGE", text + shorten(lacking[0], 60), severity="warning", file=str(root))
        )
    return source, masks


def _check_mask(mask: Path, size: Size) -> None:
    """Raise SCENE_IMAGE if the aspect ratios of a mask and its photograph differ.

    The mask may be rotated relative to its photograph.
    """
    stored = read_header(mask).size
    if not (_fits(stored, size) or _fits(stored, size[::-1])):
        text = f"it has {stored[0]} x {stored[1]} pixels, but its photograph {size[0]} x {size[1]}"
        raise SceneError("SCENE_IMAGE", text, file=mask)


def _pair_masks(root: Path, photographs: Mapping[str, Path], masks: Sequence[Path]) -> dict[str, Path]:
    """For each camera name, return the mask. Photographs and masks have the same order when sorted."""
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
