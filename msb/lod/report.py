"""The report on levels of detail and on a collision shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msb.errors import one_line

# Smallest PSNR in dB of a usable level, by its share of the faces: from half of the faces up, from a quarter
# up, and below.
THRESHOLDS = ((0.5, 35.0), (0.25, 30.0), (0.0, 25.0))


def find_threshold(share: float) -> float:
    """Return the smallest PSNR in dB of a usable level with this share of the faces."""
    return next(least for from_share, least in THRESHOLDS if share >= from_share)


@dataclass(frozen=True)
class Level:
    """A level of detail.

    Attributes
    ----------
    output : Path or None
        Its file; None if it is not written.
    share : float
        The requested share of the faces.
    faces : int
        The number of faces.
    bytes : int
        The size of its file, or the size that it would have.
    texture : (int, int) or None
        Width and height of the largest texture.
    psnr : float or None
        PSNR in dB to the whole asset in 8 views around it; infinity for equal images.
    why : str or None
        The reason why it is not usable.
    """

    output: Path | None
    share: float
    faces: int
    bytes: int
    texture: tuple[int, int] | None
    psnr: float
    why: str | None = None

    @property
    def is_usable(self) -> bool:
        """Whether it can replace the whole asset at a distance."""
        return self.why is None

    def describe(self) -> str:
        """Return the size and the quality in words."""
        texture = "" if self.texture is None else f", texture {self.texture[0]} x {self.texture[1]}"
        size = f"{self.faces:,} faces ({100 * self.share:.3g} %), {self.bytes:,} bytes{texture}"
        if self.is_usable:
            return f"{size}, {self.psnr:.1f} dB"
        written = "not usable" if self.output is not None else "not usable, not written"
        return f"{size}; {written}: {self.why}"

    def to_dict(self) -> dict[str, Any]:
        """Return the level as JSON data."""
        return {
            "output": None if self.output is None else str(self.output),
            "share": self.share,
            "faces": self.faces,
            "bytes": self.bytes,
            "texture": None if self.texture is None else list(self.texture),
            "psnr": self.psnr if self.psnr < float("inf") else None,
            "usable": self.is_usable,
            "why": self.why,
        }


@dataclass(frozen=True)
class Shape:
    """A collision shape. Distances are relative to the diagonal of the bounding box.

    `mean_distance` is the average distance from the surface to the shape. `mid_air_share` is the share of the
    exposed area of the shape that is farther than 2 % from the surface. `why` is the reason if `kind` or the
    way it was made is not the first choice, else None.
    """

    output: Path | None
    kind: str
    faces: int
    parts: int
    mean_distance: float
    mid_air_share: float
    why: str | None = None

    def describe(self) -> str:
        """Return the size and the quality in words."""
        many = f"{self.parts} convex parts" if self.kind == "hulls" else self.kind
        return (
            f"{many}, {self.faces:,} faces; on average {100 * self.mean_distance:.1f} % of the diagonal from "
            f"the surface, {100 * self.mid_air_share:.0f} % of it in mid-air"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the shape as JSON data."""
        return {**vars(self), "output": None if self.output is None else str(self.output)}


@dataclass(frozen=True)
class Report:
    """What was written. `faces` are of the whole asset, `notes` are for the user."""

    output: Path | None
    faces: int
    levels: tuple[Level, ...]
    collision: Shape | None
    notes: tuple[str, ...] = ()

    def with_outputs(
        self,
        output: Path,
        levels: list[Path | None],
        collision: Path | None,
        sizes: Mapping[Path, int] | None = None,
    ) -> Report:
        """Return the report with the paths of the files, and their sizes in bytes where these are known."""
        known = sizes or {}
        named = tuple(
            replace(level, output=path, bytes=level.bytes if path is None else known.get(path, level.bytes))
            for level, path in zip(self.levels, levels, strict=True)
        )
        shape = None if self.collision is None else replace(self.collision, output=collision)
        return replace(self, output=output, levels=named, collision=shape)

    def describe(self, *, is_brief: bool = False) -> list[str]:
        """Return a line for each file. If brief, the collision shape is left out."""
        lines = [f"{one_line(str(self.output))}: {self.faces:,} faces"]
        for number, level in enumerate(self.levels, 1):
            place = f"level {number}" if level.output is None else one_line(str(level.output))
            lines.append(f"{place}: {level.describe()}")
        if self.collision is not None and not is_brief:
            lines.append(f"{one_line(str(self.collision.output))}: {self.collision.describe()}")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON data, as `msb lod --json` writes it, without the path of the asset."""
        return {
            "schema": "msb.lod/1",
            "output": None if self.output is None else str(self.output),
            "faces": self.faces,
            "levels": [level.to_dict() for level in self.levels],
            "collision": None if self.collision is None else self.collision.to_dict(),
            "notes": list(self.notes),
        }
