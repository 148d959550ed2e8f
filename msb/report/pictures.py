"""Renderings beside each other: which views to show, and their pictures as small JPEGs."""

import base64
import io
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from msb.bench.records import ImageQuality
from msb.metrics.images import PSNR_CAP
from msb.report.numbers import (
    DRAWN_CONDITIONS,
    condition_order,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.results import Loaded, Place, ResultSet
from msb.report.safe_names import plain_text, slug

GT = "Ground truth"
_WIDTH = 480
_QUALITY = 85
_MOST_PIXELS = 1 << 26


def data_uri(kind: str, data: bytes) -> str:
    """Return the address of `data` within a page; `kind` is its MIME type."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


@dataclass(frozen=True)
class Picture:
    """A JPEG: its name in the report's folder of images, and its bytes."""

    name: str
    data: bytes

    @property
    def uri(self) -> str:
        """The picture as part of a page."""
        return data_uri("image/jpeg", self.data)


@dataclass(frozen=True)
class Shot:
    """A rendering of a view, with its heading and PSNR. `picture` is None if the file is missing or changed.

    `changed` is the path of a file that is not the one that was compared.
    """

    heading: str
    psnr: float | None
    picture: Picture | None
    changed: Path | None = None


@dataclass(frozen=True)
class View:
    """One test view: the ground truth, and for each method what each condition makes of it."""

    dataset: str
    scene: str
    image: str
    why: str
    gt: Picture | None
    # Method -> its renderings.
    shots: Mapping[str, tuple[Shot, ...]]

    @property
    def pictures(self) -> list[Picture]:
        """The pictures that there are."""
        drawn = (shot.picture for shots in self.shots.values() for shot in shots)
        return [picture for picture in (self.gt, *drawn) if picture is not None]

    @property
    def headings(self) -> list[str]:
        """The headings of all renderings."""
        return list(dict.fromkeys(shot.heading for shots in self.shots.values() for shot in shots))

    @property
    def title(self) -> str:
        """The heading of the view."""
        return (
            f"{dataset_title(self.dataset)}, {scene_title(self.scene)}, {plain_text(self.image)}: {self.why}"
        )


def views(results: ResultSet, places: Sequence[Place], chosen: Sequence[str] = ()) -> list[View]:
    """Return the views to show of `places` (of one dataset): the largest gap, a typical one, and `chosen`.

    Parameters
    ----------
    results : ResultSet
    places : sequence of Place
    chosen : sequence of str
        "SCENE/IMAGE", as records name them.
    """
    gaps = [(gap, place, image) for place in places for image, gap in _gaps(results, place).items()]
    picked: dict[tuple[str, str], str] = {}
    if gaps:
        gap, place, image = max(gaps, key=lambda one: one[0])
        picked[place.scene, image] = f"the largest loss, {gap:.2f} dB ({method_title(place.method)})"
        middle = statistics.median(one[0] for one in gaps)
        gap, place, image = min(gaps, key=lambda one: abs(one[0] - middle))
        picked.setdefault(
            (place.scene, image), f"a typical loss, {gap:.2f} dB ({method_title(place.method)})"
        )
    known = {(place.scene, image) for place in places for image in view_names(results, place)}
    for scene, image in sorted(known):
        if f"{scene}/{image}" in chosen:
            picked.setdefault((scene, image), "chosen")
    shown = []
    for (scene, image), why in picked.items():
        own = [place for place in places if place.scene == scene]
        view = _view(results, own, image, why)
        shown += [view] if view.pictures else []
    return shown


def view_names(results: ResultSet, place: Place) -> set[str]:
    """Return the names of the test views an asset was compared on."""
    return {image.name for loaded in results.places[place].values() for image in loaded.images}


def _gaps(results: ResultSet, place: Place) -> dict[str, float]:
    """Return image -> PSNR lost from the first condition there is to the last."""
    drawn = (results.places[place].get(condition) for condition in DRAWN_CONDITIONS)
    own = [loaded for loaded in drawn if loaded and loaded.result.quality]
    if len(own) < 2:
        return {}
    first, last = (
        {image.name: PSNR_CAP if (psnr := image.values["psnr"]) is None else psnr for image in loaded.images}
        for loaded in (own[0], own[-1])
    )
    return {name: first[name] - psnr for name, psnr in last.items() if name in first}


def _view(results: ResultSet, places: Sequence[Place], image: str, why: str) -> View:
    shots: dict[str, tuple[Shot, ...]] = {}
    gt: Picture | None = None
    dataset, scene = places[0].dataset, places[0].scene
    stem = f"{slug(dataset)}-{slug(scene)}-{slug(image)}"
    for place in places:
        own = []
        for condition, loaded in sorted(
            results.places[place].items(), key=lambda one: condition_order(one[0])
        ):
            compared = next((one for one in loaded.images if one.name == image), None)
            if compared is None:
                continue
            if gt is None:
                gt = _picture(loaded.file(compared.gt), compared, f"{stem}-gt.jpg")
            name = f"{stem}-{slug(place.method)}-{slug(condition)}.jpg"
            own.append(_shot(loaded, condition, compared, name))
        shots[place.method] = tuple(own)
    return View(dataset, scene, image, why, gt, shots)


def _shot(loaded: Loaded, condition: str, image: ImageQuality, name: str) -> Shot:
    """Return a rendering, without its picture where the file is not the one whose PSNR it is."""
    changed = loaded.changed(image)
    picture = None if changed else _picture(loaded.file(image.file), image, name)
    return Shot(condition_title(condition), image.values["psnr"], picture, changed)


def _picture(path: Path | None, image: ImageQuality, name: str) -> Picture | None:
    """Return the picture in a file, made small; None unless it is one of the recorded size."""
    if path is None or image.width * image.height > _MOST_PIXELS:
        return None
    from PIL import Image

    try:
        with Image.open(path, formats=("PNG", "JPEG")) as file:
            if file.size != (image.width, image.height):
                return None
            small = file.convert("RGB")
    except (OSError, ValueError, SyntaxError):  # Pillow's ways of saying that this is no picture
        return None
    if small.width > _WIDTH:
        small = small.resize((_WIDTH, round(small.height * _WIDTH / small.width)), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=_QUALITY)
    return Picture(name, buffer.getvalue())
