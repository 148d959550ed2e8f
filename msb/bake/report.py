"""The report of a bake: its result, and the quality of the result on the test views."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from msb.bake.collision import Collision
from msb.bake.options import ColorTarget, Geometry, Supervision
from msb.bake.shape import Bending, TrueShape
from msb.bake.views import BakeViews
from msb.scenes.colors import Color
from msb.topology import Audit
from msb.topology.verdict import judge
from msb.views import MIN_SEEN_SHARE

SCHEMA = "msb.bake/1"


@dataclass(frozen=True)
class Psnr:
    """Average PSNR in dB over the test views, of images with 8 bits per channel.

    Attributes
    ----------
    native : float or None
        PSNR of native renderings compared with photographs. The value is None if native renderings are the
        reference.
    before : float or None
        PSNR of the model's standard-tier mesh. The value is None if the model has no standard tier.
    after, after_16 : float
        PSNR of the baked mesh on the standard tier, with one sample per pixel and with 16.
    model_only_16 : float or None
        PSNR like `after_16`, but only over the pixels that the model or the baked mesh covers. The value is
        None if it was not measured.
    """

    native: float | None
    before: float | None
    after: float
    after_16: float
    model_only_16: float | None = None

    @property
    def is_worse(self) -> bool:
        """Whether the unbaked mesh is closer to the reference than the baked mesh, at 16 samples."""
        return self.before is not None and self.after_16 < self.before

    def to_dict(self, *, is_to_native: bool) -> dict[str, float | None]:
        """Return the quality as JSON data.

        With native renderings as supervision, the data contains `model_only_16`, otherwise `native`.
        """
        values = asdict(self)
        del values["native" if is_to_native else "model_only_16"]
        return values


@dataclass(frozen=True)
class Verdict:
    """The audit's verdict on a mesh: the level (such as "OK"), a sentence, and a short reason."""

    level: str
    sentence: str
    reason: str

    @classmethod
    def of(cls, audit: Audit) -> Verdict:
        """Return the verdict on an audited mesh."""
        verdict = judge(audit)
        return cls(verdict.level, verdict.sentence, verdict.reason)

    def to_dict(self) -> dict[str, str]:
        """Return the verdict as JSON data, in the form that an audit writes."""
        return {"level": self.level, "sentence": self.sentence}


@dataclass(frozen=True)
class LodReport:
    """A level of detail in the report of a bake.

    Attributes
    ----------
    share : float
        The requested share of the faces.
    faces : int
    native_after_16 : float or None
        PSNR in dB to native renderings with 16 samples per pixel. The value is None without a test view.
    screen_share : float
        This level can be used if the model covers at most this share of the image height
        (`msb.bake.lods.measure_screen_share`).
    bytes : int or None
    output : str or None
    """

    share: float
    faces: int
    native_after_16: float | None
    screen_share: float
    bytes: int | None = None
    output: str | None = None

    @property
    def sentence(self) -> str:
        """A sentence that describes the level of detail."""
        quality = ""
        if self.native_after_16 is not None:
            quality = f", PSNR to the native renderer {self.native_after_16:.1f} dB with 16 samples per pixel"
        height = (
            f"use this level when the object covers less than {100 * self.screen_share:.0f} % of the "
            "screen height"
        )
        return f"{self.faces:,} triangles{quality}; {height}"


@dataclass(frozen=True)
class CollisionReport:
    """The report on a collision shape, with the fields of `msb.bake.collision.Collision`."""

    kind: str
    faces: int
    parts: int
    mean_distance: float
    mid_air_share: float
    why: str
    output: str | None = None

    @classmethod
    def of(cls, shape: Collision) -> CollisionReport:
        """Return the report on a collision shape."""
        faces = len(shape.mesh.faces)
        return cls(shape.kind, faces, shape.parts, shape.mean_distance, shape.mid_air_share, shape.why)

    @property
    def sentence(self) -> str:
        """A sentence that describes the collision shape."""
        parts = "" if self.parts == 1 else f" in {self.parts} parts"
        distance = f"{100 * self.mean_distance:.1f} % of the bounding-box diagonal"
        size = f"collision shape ({self.kind}){parts}, {self.faces:,} triangles"
        return f"{size}; average distance to the visible surface: {distance}"


@dataclass(frozen=True)
class ShapeReport:
    """The shape of a connected mesh, and its difference from a true surface (`msb.bake.shape`)."""

    bending: Bending
    truth: TrueShape | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the shape as JSON data. Angles are in degrees. Depths are relative to the size of the
        surface."""
        error = depth = None
        if self.truth is not None and not math.isnan(self.truth.mean):
            error = {name: getattr(self.truth, name) for name in ("mean", "median", "above_30")}
            depth = self.truth.depth
        return {**asdict(self.bending), "normal_error": error, "depth_error": depth}

    @property
    def sentence(self) -> str:
        """A sentence that describes the shape of the mesh."""
        text = f"Shape: bending {self.bending.bending:.0f} (a smooth object has 5 to 40)"
        if self.truth is None:
            return text
        if math.isnan(self.truth.mean):
            return f"{text}; no pixel shows both surfaces at the same depth"
        return (
            f"{text}; angle to the true normals {self.truth.mean:.1f} degrees on average (median "
            f"{self.truth.median:.1f}, {100 * self.truth.above_30:.0f} % of pixels above 30 degrees); "
            f"depth error {100 * self.truth.depth:.2f} % of the object's size"
        )


@dataclass(frozen=True)
class Report:
    """The report of a bake: its result, its images, and its quality.

    Attributes
    ----------
    geometry, color : str
        The geometry is "kept", "fitted" or "surface". The colours are in a "texture" or at each "vertex".
    vertices, faces : int
    texture : (int, int) or None
        Width and height of the texture.
    bytes : int or None
        Size of the first file in bytes. The value is None before the file is written.
    seconds : float
        The time of the bake in seconds, without reading the model and writing files.
    training, validation, test, interpolated : int
        The numbers of views. Training views and interpolated views supervise. Validation views decide between
        results. Test views are held out for the measurement.
    views : str
        Where the views come from.
    supervision : str
        "native" or "photographs".
    unseen_area : float
        Share of the model's area that no training or validation view sees.
    native, photographs : Psnr or None
        PSNR on the test views, compared with native renderings and with photographs. The value is None
        without test views or photographs.
    shape : ShapeReport or None
        The shape of a connected mesh, or None for a soup.
    before : Verdict or None
        The verdict on the model's mesh, or None for Gaussians.
    after : Verdict
        The verdict on the baked mesh.
    model_faces : int
        The number of faces of the model.
    background : (float, float, float)
    seed : int
    device : str
        The OpenCL device.
    supervisions : dict of str to float
        PSNR in dB to the photographs of the validation views, with 16 samples per pixel. The keys "native"
        and "photographs" name the supervision. Empty for a single supervision.
    tried : dict of str to float
        PSNR in dB of each candidate geometry on the validation views, with 16 samples per pixel. The mapping
        is empty if only one candidate was made.
    notes : tuple of str
        Notes for the user.
    lods : tuple of LodReport
    collision : CollisionReport or None
    path, output : str or None
        The model and the first file.
    """

    geometry: Geometry
    color: ColorTarget
    vertices: int
    faces: int
    texture: tuple[int, int] | None
    seconds: float
    training: int
    validation: int
    test: int
    interpolated: int
    views: str
    supervision: str
    unseen_area: float
    native: Psnr | None
    photographs: Psnr | None
    before: Verdict | None
    after: Verdict
    model_faces: int
    background: Color
    seed: int
    device: str
    tried: dict[str, float]
    shape: ShapeReport | None = None
    supervisions: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    lods: tuple[LodReport, ...] = ()
    collision: CollisionReport | None = None
    bytes: int | None = None
    path: str | None = None
    output: str | None = None

    def with_files(self, files: Sequence[tuple[Path, int]]) -> Report:
        """Return the report with the path and the size in bytes of each written file.

        The files are the asset, its levels of detail, and its collision shape. A size includes additional
        files that the file needs.
        """
        (output, size), *more = files
        lods = tuple(
            replace(lod, output=str(path), bytes=count)
            for lod, (path, count) in zip(self.lods, more, strict=False)
        )
        collision = None if self.collision is None else replace(self.collision, output=str(more[-1][0]))
        return replace(self, output=str(output), bytes=size, lods=lods, collision=collision)

    @property
    def sentence(self) -> str:
        """The main result in one line: quality, choice, size and verdict."""
        choice = [describe_choice(self.tried)] if "surface" in self.tried else []
        return ". ".join((self.quality, *choice, self.size, self._verdict))

    @property
    def quality(self) -> str:
        """The PSNR on the test views as a sentence."""
        values, reference = self.photographs, ""
        if values is None:
            values, reference = self.native, ", compared with the native renderer"
        if values is None:
            if self.test:
                return "PSNR was not measured, because the model covers too few pixels of the views"
            return "PSNR was not measured, because no view was held out; pass two or more views"
        parts = [] if values.native is None else [f"native renderer {values.native:.1f} dB"]
        if values.before is not None:
            parts.append(f"unbaked mesh {values.before:.1f} dB")
        parts.append(f"baked {values.after:.1f} dB ({values.after_16:.1f} dB with 16 samples per pixel)")
        if values.model_only_16 is not None:
            parts.append(f"{values.model_only_16:.1f} dB over the pixels of the model")
        views = "1 held-out view" if self.test == 1 else f"{self.test} held-out views"
        return f"PSNR on {views}{reference}: {', '.join(parts)}"

    @property
    def size(self) -> str:
        """The size of the asset and the time of the bake as a sentence."""
        parts = [f"{self.faces:,} triangle{'' if self.faces == 1 else 's'}"]
        if self.texture is not None:
            parts.append(f"texture {self.texture[0]} x {self.texture[1]}")
        if self.bytes is not None:
            parts.append(f"{self.bytes / 1e6:.2f} MB")
        parts.append(f"{self.seconds:.0f} s")
        return ", ".join(parts)

    @property
    def _verdict(self) -> str:
        change = "no mesh before"
        if self.before is not None:
            is_same = self.before.level == self.after.level
            change = "as before" if is_same else f"was {self.before.level.upper()}"
        text = f"Audit: {self.after.level.upper()}, {change}"
        text += f": {self.after.reason}" if self.after.reason else ""
        # No advice is needed if a surface was already made or tried.
        can_help = self.after.level != "ok" and "surface" not in (self.geometry, *self.tried)
        return text + ("; use --geometry surface for a watertight mesh" if can_help else "")

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON data (schema msb.bake/1)."""
        data = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        views = {name: data.pop(name) for name in ("training", "validation", "test", "interpolated")}
        native, photographs = data.pop("native"), data.pop("photographs")
        before, after = data.pop("before"), data.pop("after")
        return {
            "schema": SCHEMA,
            **data,
            "views": {**views, "from": self.views},
            "psnr": {
                "native": None if native is None else native.to_dict(is_to_native=True),
                "photographs": None if photographs is None else photographs.to_dict(is_to_native=False),
            },
            "shape": None if self.shape is None else self.shape.to_dict(),
            "verdict_before": None if before is None else before.to_dict(),
            "verdict_after": after.to_dict(),
            "texture": None if self.texture is None else list(self.texture),
            "lods": [asdict(lod) for lod in self.lods],
            "collision": None if self.collision is None else asdict(self.collision),
            "background": list(self.background),
            "notes": list(self.notes),
            "sentence": self.sentence,
        }

    def extras(self) -> dict[str, Any]:
        """Return the main numbers of the report, which are stored in a GLB.

        The main numbers contain no path, time or device. Equal bakes therefore write equal files.
        """
        names = ("schema", "geometry", "color", "faces", "texture", "views", "unseen_area", "psnr")
        data = self.to_dict()
        return {key: data[key] for key in (*names, "supervision")}


def list_quality_notes(supervision: Supervision, native: Psnr | None, photographs: Psnr | None) -> list[str]:
    """Return a note if the unbaked mesh is closer to the supervising images than the baked mesh."""
    values, reference = native, "native rendering"
    if supervision == "photographs":
        values, reference = photographs, "photographs"
    if values is None or not values.is_worse:
        return []
    text = f"the unbaked mesh is closer to the {reference} than the baked mesh"
    return [f"{text}; pass more views or larger views"]


def list_coverage_notes(views: BakeViews, unseen_area: float) -> list[str]:
    """Return notes if the views show too little of the model, or if the model is too small in the views."""
    notes = [] if views.why_not_judged is None else [f"quality was not measured: {views.why_not_judged}"]
    if views.is_generated and 1 - unseen_area < MIN_SEEN_SHARE:
        kind = "inside" if views.origin == "turntable" else "outside"
        other = "" if views.origin == "both" else f"--views both or {kind}, "
        text = f"the generated views show only {100 * (1 - unseen_area):.0f} % of the model's area"
        notes.append(f"{text}; pass {other}--cameras or --scene to show more of the model")
    return notes


def describe_choice(tried: Mapping[str, float]) -> str:
    """Return the validation PSNR in dB of the candidates as a sentence."""
    return f"Validation PSNR: {', '.join(f'{name} {value:.1f} dB' for name, value in tried.items())}"


def average_psnr(values: Sequence[float]) -> float:
    """Return the average PSNR in dB. Infinite values count as the upper limit of the metric."""
    from msb.metrics.images import PSNR_CAP

    return sum(min(value, PSNR_CAP) for value in values) / len(values)
