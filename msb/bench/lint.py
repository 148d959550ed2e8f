"""Which photographs images were made from: the folder they are of, and the program that resized them.

The same scene at the same size exists in several versions: as the dataset's package has it, and resized from
larger photographs by whatever a research code calls. They differ by half a decibel in what a model scores on
them, so numbers on one are not comparable with numbers on another. Here every version that the scene's folder
can give is made again, and held against the images.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.base.files import is_file
from msb.base.paths import SpelledFiles, normal_form
from msb.errors import MetricError, shorten
from msb.metrics.ground_truth import ground_truth, mask_path
from msb.metrics.image_files import read_image, read_mask, read_pixels
from msb.metrics.images import PSNR_CAP
from msb.metrics.pairs import images_below
from msb.render.images import image_names, to_bytes
from msb.scenes.datasets.layout import folders, images_in

if TYPE_CHECKING:
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

    Pixels = NDArray[np.uint8]

SCHEMA = "msb.lint/1"
MOST_VIEWS = 8
SAME = 50.0
"""dB above which two images differ by nothing but rounding."""
_PHOTOGRAPH = 38.0
"""dB to the nearest version of the photographs above which images are photographs, not renderings."""
_JPEG_GAIN = 3.0
_SURE = {True: 2.0, False: 0.05}
"""dB by which the nearest version must lead for it to be told, of photographs and of renderings: by so little
also in views that are all alike."""
_QUALITIES = (50, 60, 70, 75, 80, 85, 90, 92, 95, 98)
_THUMBNAIL = 32


class Version(NamedTuple):
    """One version of a scene's photographs."""

    folder: str
    resampler: str
    """"" as the folder has them; else a key of `RESAMPLERS`."""
    jpeg: str = ""
    """How they were written as JPEG afterwards, "" if not."""

    def __str__(self) -> str:
        folder = "the photographs" if self.folder == "." else self.folder
        made = (
            f"{folder} resized by {self.resampler}" if self.resampler else f"{folder} as the scene has them"
        )
        return f"{made}, then saved as JPEG {self.jpeg}" if self.jpeg else made


@dataclass(frozen=True)
class Lint:
    """What images were made from, over `views` views. Numbers are in dB, means over the views.

    `versions` are all that could be made, each with its PSNR, the nearest first; `same_as_best` those that
    cannot be told from the nearest; `margin` the lead over the first of the others, None without one.
    `wanted` is what the scene is compared with, None at another size, and `size_note` then says so. `cost` is
    by how much renderings score more on these photographs than on those of the scene, where both are given.
    """

    folder: Path
    scene: Path
    views: int
    size: tuple[int, int]
    wanted: Version | None
    size_note: str | None
    photographs: bool
    strangers: bool
    versions: Mapping[Version, float]
    same_as_best: tuple[Version, ...]
    margin: float | None
    told: bool
    cost: float | None = None

    @property
    def best(self) -> Version | None:
        """The nearest version."""
        return next(iter(self.versions), None)

    @property
    def is_wanted(self) -> bool:
        """Whether the images may be of the very photographs with which the scene is compared."""
        return not self.strangers and self.size_note is None and (
            not self.told or self.wanted in self.same_as_best
        )  # fmt: skip

    @property
    def sentence(self) -> str:
        """What was found."""
        if self.strangers:
            return (
                "they are not these views of this scene: each is as near to the photograph of another view; "
                "it is another scene, another split, or another order"
            )
        size = "" if self.size_note is None else f"; {self.size_note}"
        if self.best is None:
            return f"no folder of photographs is as large as they are{size}"
        names = " or ".join(map(str, self.same_as_best))
        if not self.told:
            why = "" if self.margin is None else f", only {self.margin:.2f} dB ahead of the next"
            return f"it cannot be told; nearest is {names}{why}{size}"
        lead = "" if self.margin is None else f", {self.margin:.2f} dB ahead of the next"
        what = f"they are {names}" if self.photographs else f"they fit {names} best{lead}"
        if self.wanted is not None and self.wanted not in self.same_as_best:
            apart = self.versions[self.wanted]
            what += f", not {self.wanted}"
            if self.cost is not None:
                what += f": the renderings score {self.cost:+.2f} dB by that"
            elif self.photographs:
                what += f": {apart:.2f} dB between the two"
            else:
                what += f": {self.versions[self.best] - apart:.2f} dB"
        return f"{what}{size}"

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as JSON data (schema msb.lint/1)."""
        return {
            "schema": SCHEMA,
            "folder": str(self.folder),
            "scene": str(self.scene),
            "views": self.views,
            "width": self.size[0],
            "height": self.size[1],
            "images": "photographs" if self.photographs else "renderings",
            "of_these_views": not self.strangers,
            "is_wanted": self.is_wanted,
            "told": self.told,
            "sentence": self.sentence,
            "wanted": None if self.wanted is None else self.wanted._asdict(),
            "best": [one._asdict() for one in self.same_as_best],
            "margin": self.margin,
            "cost": self.cost,
            "versions": [{**one._asdict(), "psnr": value} for one, value in self.versions.items()],
        }


def lint_images(folder: Path, scene: Scene, step: Callable[[], None] = lambda: None) -> Lint:
    """Return what the images in `folder` were made from, photographs or renderings of the scene's views.

    A folder with `gt` and `renders`, as official code writes them, is judged by its `gt`, and the renderings
    are held against both. Images have the photographs' names, or are called 00000, 00001, ... in the order of
    the test views. At most `MOST_VIEWS` of them are looked at; `step` is called after each.

    Raises
    ------
    MetricError
        METRIC_IMAGE_NAMES: the names are not those of views, or `gt` and `renders` have other views.
        METRIC_IMAGE: a file is damaged.
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    """
    both = folder / "gt", folder / "renders"
    if not all(each.is_dir() for each in both):
        return _lint(folder, scene, step)
    found = _lint(both[0], scene, step)
    if found.wanted is None or found.strangers:
        return found
    truths = _matched(both[0], scene)
    files = {str(camera.name): file for camera, file in _matched(both[1], scene)}
    if alone := sorted(files.keys() ^ {str(camera.name) for camera, _ in truths}):
        text = f"{shorten(alone[0], 80)} is in one of gt and renders only; both must have the same views"
        raise MetricError("METRIC_IMAGE_NAMES", text, file=folder)
    scores = []
    for camera, truth in _spread(truths):
        image, own = (_read(path, scene) for path in (files[str(camera.name)], truth))
        if image.shape == own.shape:
            scores.append(_psnr(image, own) - _psnr(image, to_bytes(ground_truth(scene, camera))))
    return replace(found, cost=float(np.mean(scores)) if scores else None)


def _lint(folder: Path, scene: Scene, step: Callable[[], None]) -> Lint:
    views = _spread(_matched(folder, scene))
    shown: list[Pixels] = []
    scores: list[dict[Version, float]] = []
    first: dict[Version, Pixels] = {}
    sources = list(_sources(scene))
    for camera, path in views:
        image = _read(path, scene)
        made = dict(_versions(scene, camera, sources, (image.shape[1], image.shape[0])))
        first = first or made
        shown.append(image)
        scores.append({version: _psnr(image, pixels) for version, pixels in made.items()})
        step()
    first = {version: first[version] for version in first if all(version in own for own in scores)}
    table = {version: np.array([own[version] for own in scores]) for version in first}
    strangers = _are_strangers(shown, [camera for camera, _ in views], scene)
    if not strangers and table:
        table |= _as_jpeg(shown, views, scene, sources, table)
    ranked = dict(sorted(table.items(), key=lambda one: -one[1].mean()))
    size = shown[0].shape[1], shown[0].shape[0]
    camera = views[0][0]
    note = _size_note(scene, size, camera)
    wanted = Version(scene.image_folder, f"PIL {scene.resampling}" if scene.gt_resized else "")
    photographs = bool(ranked) and float(next(iter(ranked.values())).mean()) >= _PHOTOGRAPH
    photographs |= bool(ranked) and bool(next(iter(ranked)).jpeg)
    same, margin, told = _lead(ranked, first, photographs)
    return Lint(
        folder, scene.root, len(views), size, wanted if note is None and wanted in ranked else None, note,
        photographs, strangers, {version: float(values.mean()) for version, values in ranked.items()},
        same, margin, told,
    )  # fmt: skip


def _lead(
    ranked: Mapping[Version, NDArray[np.float64]], first: Mapping[Version, Pixels], photographs: bool
) -> tuple[tuple[Version, ...], float | None, bool]:
    """Return the versions as good as the nearest, its lead over the others, and whether it counts."""
    if not ranked:
        return (), None, False
    best = next(iter(ranked))
    plain = best._replace(jpeg="")
    # Of one view: a box over whole pixels is the same in every program.
    alike = {one for one in first if one == plain or _psnr(first[one], first[plain]) >= SAME}
    same = (best, *(one._replace(jpeg=best.jpeg) for one in first if one in alike - {plain}))
    others = [values for one, values in ranked.items() if one._replace(jpeg="") not in alike]
    if not others:
        return same, None, photographs
    lead = ranked[best] - others[0]
    error = float(lead.std(ddof=1)) / math.sqrt(len(lead)) if len(lead) > 1 else 0.0
    margin = float(lead.mean())
    return same, margin, margin >= max(_SURE[photographs], 2 * error)


def _size_note(scene: Scene, size: tuple[int, int], camera: Camera) -> str | None:
    if size == (camera.width, camera.height):
        return None
    wanted = "" if scene.image_folder == "." else f" ({scene.image_folder})"
    return (
        f"at {size[0]} x {size[1]}, where the scene is compared at {camera.width} x {camera.height}{wanted}"
    )


def _matched(folder: Path, scene: Scene) -> list[tuple[Camera, Path]]:
    """Return the test views that `folder` has images of; training views, if there is no test view."""
    full = images_below(folder)
    files = {name.rpartition("/")[2]: path for name, path in full.items()}
    for cameras in (scene.test, scene.train):
        names = [normal_form(name) for name in image_names(cameras)]
        for own, keys in ((full, names), (files, [name.rpartition("/")[2] for name in names])):
            if found := [(c, own[key]) for c, key in zip(cameras, keys, strict=True) if key in own]:
                return found
    numbers = [f"{index:05d}" for index in range(len(files))]
    for cameras in (scene.test, scene.train):
        if len(cameras) == len(files) and set(files) == set(numbers):
            return [(camera, files[number]) for camera, number in zip(cameras, numbers, strict=True)]
    text = (
        f"its {len(full)} images have no view's name, nor are they 00000, 00001, ... of all "
        f"{len(scene.test)} test views"
    )
    raise MetricError("METRIC_IMAGE_NAMES", text, file=folder)


def _spread(views: Sequence[tuple[Camera, Path]]) -> list[tuple[Camera, Path]]:
    """Return at most `MOST_VIEWS` of them, from the first to the last."""
    count = min(len(views), MOST_VIEWS)
    return [views[round(place)] for place in np.linspace(0, len(views) - 1, count)]


def _read(path: Path, scene: Scene) -> Pixels:
    image = read_image(path, background=scene.background)
    return image if image.dtype == np.uint8 else to_bytes(image)


def _sources(scene: Scene) -> Iterator[tuple[str, SpelledFiles]]:
    """Yield the folders of photographs; where names lead to the files there is one."""
    if scene.image_folder == ".":
        yield ".", SpelledFiles(scene.root)
        return
    for folder in folders(scene.root):
        if images_in(folder):
            yield folder.name, SpelledFiles(folder)


def _versions(
    scene: Scene, camera: Camera, sources: Sequence[tuple[str, SpelledFiles]], size: tuple[int, int]
) -> Iterator[tuple[Version, Pixels]]:
    """Yield every version of a view's photograph at `size` that the scene's folder can give."""
    for name, files in sources:
        path = files.find(str(camera.name))
        if not is_file(path):
            continue
        stored = _photograph(scene, camera, path)
        height, width = stored.shape[:2]
        if (width, height) == size:
            yield Version(name, ""), stored
        elif width >= size[0] and height >= size[1]:
            for resampler, resize in RESAMPLERS.items():
                yield Version(name, resampler), resize(stored, size)


def _photograph(scene: Scene, camera: Camera, path: Path) -> Pixels:
    """Return a photograph at its stored size, over the scene's background where it has a mask."""
    if scene.mask_source != "mask_folder":
        return _read(path, scene)
    color = read_pixels(path)[..., :3]
    mask = read_mask(mask_path(scene, camera))
    if mask.shape != color.shape[:2]:
        return color
    weight = mask[..., None] / 255.0
    return to_bytes(color / 255.0 * weight + np.asarray(scene.background) * (1 - weight))


def _pil(filter_name: str) -> Callable[[Pixels, tuple[int, int]], Pixels]:
    def resize(image: Pixels, size: tuple[int, int]) -> Pixels:
        from PIL import Image

        return np.asarray(Image.fromarray(image).resize(size, Image.Resampling[filter_name]))

    return resize


def _sampled(filter_name: str) -> Callable[[Pixels, tuple[int, int]], Pixels]:
    """Return a resampler that looks at the pixels around each new one's centre alone, however far it shrinks.

    These are torch's `interpolate` without antialiasing, and OpenCV's INTER_LINEAR and INTER_NEAREST.
    """

    def resize(image: Pixels, size: tuple[int, int]) -> Pixels:
        from PIL import Image

        scale = image.shape[1] / size[0], image.shape[0] / size[1]
        matrix = (scale[0], 0.0, 0.0, 0.0, scale[1], 0.0)
        own = Image.fromarray(image)
        return np.asarray(own.transform(size, Image.Transform.AFFINE, matrix, Image.Resampling[filter_name]))

    return resize


def _area(image: Pixels, size: tuple[int, int]) -> Pixels:
    """Return OpenCV's INTER_AREA: the mean over each new pixel's part of the old ones; cut ones by share."""
    return np.stack([_area_plane(plane, size) for plane in np.moveaxis(image, 2, 0)], axis=-1)


def _area_plane(plane: Pixels, size: tuple[int, int]) -> Pixels:
    values = plane.astype(np.float64)
    for axis, count in ((0, size[1]), (1, size[0])):
        length = values.shape[axis]
        sums = np.concatenate([np.zeros_like(values.take([0], axis)), np.cumsum(values, axis)], axis)
        edges = np.linspace(0, length, count + 1)
        low = np.minimum(edges.astype(np.intp), length - 1)
        share = np.expand_dims(edges - low, 1 - axis)
        at = sums.take(low, axis) * (1 - share) + sums.take(low + 1, axis) * share
        values = np.diff(at, axis=axis) * (count / length)
    return np.rint(values).clip(0, 255).astype(np.uint8)


RESAMPLERS: Mapping[str, Callable[[Pixels, tuple[int, int]], Pixels]] = {
    "PIL bicubic": _pil("BICUBIC"),
    "PIL bilinear": _pil("BILINEAR"),
    "PIL Lanczos": _pil("LANCZOS"),
    "PIL box": _pil("BOX"),
    "PIL Hamming": _pil("HAMMING"),
    "OpenCV area": _area,
    "bilinear without antialiasing (OpenCV, torch)": _sampled("BILINEAR"),
    "nearest neighbour": _sampled("NEAREST"),
}
"""Name -> what resizes (H, W, 3) bytes to (width, height). The 3DGS family calls PIL bicubic."""


def _psnr(first: Pixels, second: Pixels) -> float:
    error = float(np.mean(np.square(first.astype(np.float32) - second.astype(np.float32)), dtype=np.float64))
    return PSNR_CAP if error == 0 else min(PSNR_CAP, 10 * math.log10(255**2 / error))


def _as_jpeg(
    shown: Sequence[Pixels],
    views: Sequence[tuple[Camera, Path]],
    scene: Scene,
    sources: Sequence[tuple[str, SpelledFiles]],
    table: Mapping[Version, NDArray[np.float64]],
) -> dict[Version, NDArray[np.float64]]:
    """Return the scores of the versions written as JPEG, if the images were: that brings one much nearer.

    What JPEG leaves out can hide which version it is, so all of them are tried on the first view.
    """
    plain = max(float(values.mean()) for values in table.values())
    if plain >= SAME:
        return {}
    camera, path = views[0]
    made = dict(_versions(scene, camera, sources, (shown[0].shape[1], shown[0].shape[0])))
    ways = [*_own_tables(path), *((f"of quality {quality}", {"quality": quality}) for quality in _QUALITIES)]
    tried = {
        (version, said): (_psnr(shown[0], _jpeg(made[version], options)), options)
        for version in table
        for said, options in ways
    }
    (_, said), (best, options) = max(tried.items(), key=lambda one: one[1][0])
    if best < plain + _JPEG_GAIN:
        return {}
    found: dict[Version, list[float]] = {}
    for image, (view, _) in zip(shown, views, strict=True):
        for version, pixels in _versions(scene, view, sources, (image.shape[1], image.shape[0])):
            if version in table:
                own = version._replace(jpeg=said)
                found.setdefault(own, []).append(_psnr(image, _jpeg(pixels, options)))
    return {version: np.array(values) for version, values in found.items()}


def _own_tables(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield how a file that is a JPEG was written itself."""
    from PIL import Image, JpegImagePlugin

    if path.suffix.lower() in (".jpg", ".jpeg"):
        opened: Any = Image.open(path, formats=("JPEG",))
        with opened:
            tables, sampling = opened.quantization, JpegImagePlugin.get_sampling(opened)
        if sampling >= 0:
            yield "with the tables of these files", {"qtables": tables, "subsampling": sampling}


def _jpeg(image: Pixels, options: Mapping[str, Any]) -> Pixels:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", **options)
    with Image.open(buffer) as file:
        return np.asarray(file)


def _are_strangers(shown: Sequence[Pixels], cameras: Sequence[Camera], scene: Scene) -> bool:
    """Return whether most images are nearer to the photograph of another view than to their own's."""
    if len(shown) < 2:
        return False
    small = _pil("BOX")
    size = _THUMBNAIL, _THUMBNAIL
    images = [small(image, size).astype(np.float64) for image in shown]
    truths = [small(to_bytes(ground_truth(scene, camera)), size).astype(np.float64) for camera in cameras]
    errors = np.array([[np.mean(np.square(image - truth)) for truth in truths] for image in images])
    return bool(np.mean(errors.argmin(axis=1) == np.arange(len(images))) <= 0.5)
