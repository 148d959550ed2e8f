"""Notes on how methods of one table were measured differently: image folder and size, cameras, background."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from msb.report.numbers import MEAN, QUALITY, Key, Number

if TYPE_CHECKING:
    from msb.bench.records import Result
    from msb.report.results import Place

WHITE = "photographs and renderings over white, as in the dataset's protocol"
_OVER_WHITE = ("dtu", "nerf_synthetic")
_COLORS = {(0.0, 0.0, 0.0): "black", (1.0, 1.0, 1.0): "white"}
_CAMERAS = {
    "gs_fov": "gs_fov (the principal point in the middle)",
    "full_K": "full_K (the principal point where it is)",
}


def with_setups(
    values: Mapping[Key, Number], records: Mapping[Place, Mapping[str, Result]]
) -> dict[Key, Number]:
    """Return `values`, with a note on image metrics wherever a setup is not that of most on its scene."""
    setups = {
        place: described
        for place, conditions in records.items()
        if (described := next(filter(None, map(_described, conditions.values())), None))
    }
    notes: dict[tuple[str, str], dict[str, None]] = {}
    trained: dict[tuple[str, str, str], dict[str, None]] = {}
    for (dataset, scene, method), conditions in records.items():
        for text in dict.fromkeys(text for one in conditions.values() for text in one.trained):
            for row in (scene, MEAN):  # in the same words, so that a table has them once
                trained.setdefault((dataset, row, method), {})[f"{scene}: {text}"] = None
    for place, own in setups.items():
        others = [one for other, one in setups.items() if other[:2] == place[:2]]
        for what, value in own.items():
            usual = Counter(one[what] for one in others).most_common(1)[0][0]
            if value != usual:
                note = f"{what} {value}, where the other methods have {usual}"
                notes.setdefault((place.dataset, place.method), {})[note] = None
        if place.dataset in _OVER_WHITE and own["background"] == "white":
            notes.setdefault((place.dataset, place.method), {})[WHITE] = None
    return {
        key: replace(
            number,
            notes=(
                *number.notes,
                *notes.get((key.dataset, key.method), ()),
                *trained.get((key.dataset, key.scene, key.method), ()),
            ),
        )
        if key.metric in QUALITY and number.value is not None
        else number
        for key, number in values.items()
    }


def _described(result: Result) -> dict[str, str] | None:
    """Return what of a record's setup must be the same for two methods to be compared like for like."""
    if result.setup is None:
        return None
    images = () if result.quality is None else result.quality.images
    sizes = Counter((image.width, image.height) for image in images).most_common(1)
    background = result.setup.background
    return {
        "images of": result.setup.image_folder,
        "image size": f"{sizes[0][0][0]} x {sizes[0][0][1]}" if sizes else "unknown",
        "camera convention": _CAMERAS[result.setup.camera_convention],
        "background": _COLORS.get(background, ", ".join(f"{value:g}" for value in background)),
    }
