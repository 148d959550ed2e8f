"""What a bake says of what it made: measured on what is written, from views that no choice was made by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from msb.bake.collision import Collision
from msb.bake.options import Geometry, Look
from msb.scenes.colors import Color
from msb.topology import Audit
from msb.topology.verdict import judge

SCHEMA = "msb.bake/1"
WORSE = "the plain mesh was nearer to its own look: give more views, or larger ones"


@dataclass(frozen=True)
class Psnr:
    """Means over the views held back, in dB, of images of 8 bits; None where there is nothing to compare.

    Attributes
    ----------
    dedicated : float or None
        Of the model's own look; None where that is what the others are compared with.
    before : float or None
        Of the model's standard tier; None of a model without one.
    after, after_16 : float
        Of what was made, on the standard tier, with one sample a pixel and with 16.
    """

    dedicated: float | None
    before: float | None
    after: float
    after_16: float

    @property
    def is_worse(self) -> bool:
        """Whether the plain mesh was nearer than what was made is with 16 samples."""
        return self.before is not None and self.after_16 < self.before

    def to_dict(self, *, own: bool) -> dict[str, float | None]:
        """Return it as JSON data; its `own` look has no number of its own."""
        values = asdict(self)
        if own:
            del values["dedicated"]
        return values


@dataclass(frozen=True)
class Verdict:
    """The verdict on a mesh: its level, a sentence, and in a few words what stands in the way."""

    level: str
    sentence: str
    reason: str

    @classmethod
    def of(cls, audit: Audit) -> Verdict:
        """Return the verdict on an audited mesh."""
        verdict = judge(audit)
        return cls(verdict.level, verdict.sentence, verdict.reason)

    def to_dict(self) -> dict[str, str]:
        """Return it as an audit's JSON has it."""
        return {"level": self.level, "sentence": self.sentence}


@dataclass(frozen=True)
class Level:
    """A level of detail, and how small it may be shown.

    Attributes
    ----------
    share : float
        Of the faces, as asked for.
    faces : int
    own_after_16 : float or None
        dB to the own look with 16 samples a pixel; None where no view is held back.
    screen_share : float
        The share of an image's height below which it is enough (`msb.bake.lods.screen_share`).
    bytes : int or None
    output : str or None
    """

    share: float
    faces: int
    own_after_16: float | None
    screen_share: float
    bytes: int | None = None
    output: str | None = None

    @property
    def said(self) -> str:
        """What it is, in a line."""
        own = (
            ""
            if self.own_after_16 is None
            else f", {self.own_after_16:.1f} dB to its own look with 16 samples"
        )
        below = f"enough below {100 * self.screen_share:.0f} % of the image's height"
        return f"{self.faces:,} triangles{own}; {below}"


@dataclass(frozen=True)
class Shape:
    """A collision shape, with the facts of `msb.bake.collision.Collision`."""

    kind: str
    faces: int
    parts: int
    mean_distance: float
    mid_air_share: float
    why: str
    output: str | None = None

    @classmethod
    def of(cls, made: Collision) -> Shape:
        """Return the facts of what was made."""
        faces = len(made.mesh.faces)
        return cls(made.kind, faces, made.parts, made.mean_distance, made.mid_air_share, made.why)

    @property
    def said(self) -> str:
        """What it is, in a line."""
        parts = "" if self.parts == 1 else f" in {self.parts} parts"
        apart = f"{100 * self.mean_distance:.1f} % of the diagonal from what is seen in the mean"
        return f"{self.kind}{parts}, {self.faces:,} triangles, {apart}"


@dataclass(frozen=True)
class Report:
    """What was made of a model, by what, and what it lost.

    Attributes
    ----------
    geometry, color : str
        What was made: "kept" or "fitted" faces or a "surface", with a "texture" or colours of vertices.
    vertices, faces : int
    texture : (int, int) or None
        Its width and height.
    bytes : int or None
        Of the first file; None before one is written.
    seconds : float
        From the model in memory to what is written.
    taught, between, held_back : int
        Numbers of views: of those that teach, of those made between these, which teach as well where they are
        few, and of those that the numbers are of.
    views, teacher : str
        Where the views are from, and what taught.
    unseen_area : float
        The share of the model's area that no view saw which teaches.
    own, photographs : Psnr or None
        Against the model's own look, and against photographs; None where no view is held back, or no
        photograph is there.
    before, after : Verdict
        On the model's mesh, and on what was made.
    model_faces : int
        The faces of the model.
    background : (float, float, float)
    seed : int
    device : str
        What drew.
    tried : dict of str to float
        Geometry -> dB on the views kept aside, with 16 samples a pixel, where there was a choice.
    notes : tuple of str
        What else should be known.
    lods : tuple of Level
    collision : Shape or None
    path, output : str or None
        The model and the first file.
    """

    geometry: Geometry
    color: Look
    vertices: int
    faces: int
    texture: tuple[int, int] | None
    seconds: float
    taught: int
    between: int
    held_back: int
    views: str
    teacher: str
    unseen_area: float
    own: Psnr | None
    photographs: Psnr | None
    before: Verdict
    after: Verdict
    model_faces: int
    background: Color
    seed: int
    device: str
    tried: dict[str, float]
    notes: tuple[str, ...] = ()
    lods: tuple[Level, ...] = ()
    collision: Shape | None = None
    bytes: int | None = None
    path: str | None = None
    output: str | None = None

    def written(self, files: Sequence[tuple[Path, int]]) -> Report:
        """Return the report on files of so many bytes, with those that they need beside them.

        They are that of the asset, those of its levels of detail, and that of its collision shape.
        """
        (output, size), *more = files
        lods = tuple(
            replace(one, output=str(path), bytes=count)
            for one, (path, count) in zip(self.lods, more, strict=False)
        )
        shape = None if self.collision is None else replace(self.collision, output=str(more[-1][0]))
        return replace(self, output=str(output), bytes=size, lods=lods, collision=shape)

    @property
    def sentence(self) -> str:
        """What was lost, and what is there now, in a line."""
        choice = [compared(self.tried)] if "surface" in self.tried else []
        return "; ".join((self.loss, *choice, self.made, self._verdict))

    @property
    def loss(self) -> str:
        """The numbers of the views held back."""
        shown, of = self.photographs, ""
        if shown is None:
            shown, of = self.own, " to its own look"
        if shown is None:
            return "no dB, as no view is held back: that takes two or more"
        parts = [] if shown.dedicated is None else [f"own look {shown.dedicated:.1f} dB"]
        unit = "" if parts else " dB"
        if shown.before is not None:
            parts.append(f"plain mesh before {shown.before:.1f}{unit}")
            unit = ""
        parts.append(f"baked {shown.after:.1f}{unit} ({shown.after_16:.1f} with 16 samples){of}")
        views = "1 view" if self.held_back == 1 else f"{self.held_back} views"
        return f"{', '.join(parts)}, on {views} it never used"

    @property
    def made(self) -> str:
        """How large it is, and how long it took."""
        parts = [f"{self.faces:,} triangle{'' if self.faces == 1 else 's'}"]
        if self.texture is not None:
            parts.append(f"texture {self.texture[0]}")
        if self.bytes is not None:
            parts.append(f"{self.bytes / 1e6:.2f} MB")
        parts.append(f"{self.seconds:.0f} s")
        return ", ".join(parts)

    @property
    def _verdict(self) -> str:
        word = self.after.level.upper()
        was = " as before" if self.before.level == self.after.level else f", was {self.before.level.upper()}"
        text = f"{word}{was}" + (f": {self.after.reason}" if self.after.reason else "")
        # Where a surface is there, or was tried, nothing else helps.
        helps = self.after.level == "bad" and "surface" not in (self.geometry, *self.tried)
        return text + (": --geometry surface for solids" if helps else "")

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data (schema msb.bake/1)."""
        data = {each.name: getattr(self, each.name) for each in fields(self)}
        views = {name: data.pop(name) for name in ("taught", "between", "held_back")}
        own, photographs = data.pop("own"), data.pop("photographs")
        before, after = data.pop("before"), data.pop("after")
        return {
            "schema": SCHEMA,
            **data,
            "views": {**views, "from": self.views},
            "psnr": {
                "own": None if own is None else own.to_dict(own=True),
                "photographs": None if photographs is None else photographs.to_dict(own=False),
            },
            "verdict_before": before.to_dict(),
            "verdict_after": after.to_dict(),
            "texture": None if self.texture is None else list(self.texture),
            "lods": [asdict(one) for one in self.lods],
            "collision": None if self.collision is None else asdict(self.collision),
            "background": list(self.background),
            "notes": list(self.notes),
            "sentence": self.sentence,
        }

    def extras(self) -> dict[str, Any]:
        """Return the main numbers, which a file of the mesh carries: no paths, nothing of the machine.

        They are the same whenever the same is made.
        """
        kept = ("schema", "geometry", "color", "faces", "texture", "views", "unseen_area", "psnr", "teacher")
        data = self.to_dict()
        return {key: data[key] for key in kept}


def compared(tried: Mapping[str, float]) -> str:
    """Return the dB between which a choice was made, in words."""
    return f"{', '.join(f'{name} {value:.1f} dB' for name, value in tried.items())} by views kept aside"


def mean(values: Sequence[float]) -> float:
    """Return the mean of dB, in which an infinite one counts as the metric's cap."""
    from msb.metrics.images import PSNR_CAP

    return sum(min(value, PSNR_CAP) for value in values) / len(values)
