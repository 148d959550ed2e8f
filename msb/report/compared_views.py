"""Choose test views, and show their renderings side by side as small JPEG images."""

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
from msb.report.results import LoadedResult, Place, ResultSet
from msb.report.safe_names import plain_text, slug

GROUND_TRUTH = "Ground truth"
# Maximum width of the images in pixels, and JPEG quality. A page with tens of such images takes a few
# megabytes.
_WIDTH = 480
_QUALITY = 85
# Do not open images above 64 megapixels, because a record can claim any size.
_MAX_PIXELS = 1 << 26


def data_uri(kind: str, data: bytes) -> str:
    """Return `data` as a data URI that a page can embed. `kind` is the MIME type of the data."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


@dataclass(frozen=True)
class JpegImage:
    """A JPEG image: its file name in the report's folder ``images``, and its bytes."""

    name: str
    data: bytes

    @property
    def uri(self) -> str:
        """The image as a data URI that a page can embed."""
        return data_uri("image/jpeg", self.data)


@dataclass(frozen=True)
class Rendering:
    """A rendering of a test view.

    Attributes
    ----------
    heading : str
        The condition.
    psnr : float or None
        PSNR in dB; None if the rendering equals the ground truth.
    image : JpegImage or None
        The image; None if the file is missing or has changed since its comparison with the ground truth.
    changed : Path or None
        The file of the rendering, if the file has changed since the comparison.
    """

    heading: str
    psnr: float | None
    image: JpegImage | None
    changed: Path | None = None


@dataclass(frozen=True)
class ComparedView:
    """A test view, with its photograph and the renderings of each method under all conditions.

    `why` explains the choice of the view, such as "the largest loss". `renderings` maps each method to its
    renderings.
    """

    dataset: str
    scene: str
    view: str
    why: str
    ground_truth: JpegImage | None
    renderings: Mapping[str, tuple[Rendering, ...]]

    @property
    def images(self) -> list[JpegImage]:
        """All existing images of the view."""
        images = (rendering.image for row in self.renderings.values() for rendering in row)
        return [image for image in (self.ground_truth, *images) if image is not None]

    @property
    def headings(self) -> list[str]:
        """The conditions of all renderings of the view."""
        return list(dict.fromkeys(rendering.heading for row in self.renderings.values() for rendering in row))

    @property
    def title(self) -> str:
        """The heading of the view."""
        return (
            f"{dataset_title(self.dataset)}, {scene_title(self.scene)}, {plain_text(self.view)}: {self.why}"
        )


def select_views(
    results: ResultSet, places: Sequence[Place], chosen: Sequence[str] = ()
) -> list[ComparedView]:
    """Return the views with the largest and the median loss, and the views in `chosen`.

    Parameters
    ----------
    results : ResultSet
    places : sequence of Place
        The assets of one dataset.
    chosen : sequence of str
        "SCENE/IMAGE", as in the records.
    """
    # For every view, collect the asset, the view, and the PSNR loss in dB between two conditions.
    losses = [(loss, place, view) for place in places for view, loss in _find_losses(results, place).items()]
    selected: dict[tuple[str, str], str] = {}
    if losses:
        loss, place, view = max(losses, key=lambda item: item[0])
        selected[place.scene, view] = f"the largest loss, {loss:.2f} dB ({method_title(place.method)})"
        median = statistics.median(item[0] for item in losses)
        loss, place, view = min(losses, key=lambda item: abs(item[0] - median))
        typical = f"a typical loss, {loss:.2f} dB ({method_title(place.method)})"
        selected.setdefault((place.scene, view), typical)
    known = {(place.scene, view) for place in places for view in view_names(results, place)}
    for scene, view in sorted(known):
        if f"{scene}/{view}" in chosen:
            selected.setdefault((scene, view), "chosen")
    views = []
    for (scene, name), why in selected.items():
        of_scene = [place for place in places if place.scene == scene]
        compared = _make_view(results, of_scene, name, why)
        views += [compared] if compared.images else []
    return views


def view_names(results: ResultSet, place: Place) -> set[str]:
    """Return the names of the test views of an asset."""
    return {image.name for loaded in results.places[place].values() for image in loaded.images}


def _find_losses(results: ResultSet, place: Place) -> dict[str, float]:
    """Return the PSNR loss in dB of each view, between the first and the last condition with images."""
    loaded = (results.places[place].get(condition) for condition in DRAWN_CONDITIONS)
    with_images = [record for record in loaded if record and record.result.quality]
    if len(with_images) < 2:
        return {}
    first, last = (
        {image.name: PSNR_CAP if (psnr := image.values["psnr"]) is None else psnr for image in record.images}
        for record in (with_images[0], with_images[-1])
    )
    return {name: first[name] - psnr for name, psnr in last.items() if name in first}


def _make_view(results: ResultSet, places: Sequence[Place], view: str, why: str) -> ComparedView:
    """Return a view of one scene. The renderings are from the assets at `places`."""
    renderings: dict[str, tuple[Rendering, ...]] = {}
    ground_truth: JpegImage | None = None
    dataset, scene = places[0].dataset, places[0].scene
    stem = f"{slug(dataset)}-{slug(scene)}-{slug(view)}"
    for place in places:
        row = []
        conditions = results.places[place]
        for condition in sorted(conditions, key=condition_order):
            loaded = conditions[condition]
            compared = next((image for image in loaded.images if image.name == view), None)
            if compared is None:
                continue
            if ground_truth is None:
                ground_truth = _read_image(loaded.file(compared.gt), compared, f"{stem}-gt.jpg")
            name = f"{stem}-{slug(place.method)}-{slug(condition)}.jpg"
            row.append(_make_rendering(loaded, condition, compared, name))
        renderings[place.method] = tuple(row)
    return ComparedView(dataset, scene, view, why, ground_truth, renderings)


def _make_rendering(loaded: LoadedResult, condition: str, compared: ImageQuality, name: str) -> Rendering:
    """Return a rendering. If the image file has changed since its comparison, the image is omitted."""
    changed = loaded.changed_file(compared)
    image = None if changed else _read_image(loaded.file(compared.file), compared, name)
    return Rendering(condition_title(condition), compared.values["psnr"], image, changed)


def _read_image(path: Path | None, compared: ImageQuality, name: str) -> JpegImage | None:
    """Return an image file as a small JPEG called `name`.

    If the size of the image differs from the record, return None.
    """
    if path is None or compared.width * compared.height > _MAX_PIXELS:
        return None
    from PIL import Image

    try:
        with Image.open(path, formats=("PNG", "JPEG")) as file:
            if file.size != (compared.width, compared.height):
                return None
            small = file.convert("RGB")
    except (OSError, ValueError, SyntaxError):  # Pillow raises these errors for files that are not images
        return None
    if small.width > _WIDTH:
        small = small.resize((_WIDTH, round(small.height * _WIDTH / small.width)), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=_QUALITY)
    return JpegImage(name, buffer.getvalue())
