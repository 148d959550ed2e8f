"""What is asked of a bake, refused before anything is read where it is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from msb.asset.look import tint_of
from msb.asset.texture import MAX_SIDE, textures_of
from msb.asset.tiers import why_not
from msb.bake.atlas import need_xatlas
from msb.bake.lods import need_simplification
from msb.bake.report import Geometry, Look
from msb.bake.soup import is_uncut_soup
from msb.bake.teacher import Source
from msb.base.extras import is_installed, need_extra
from msb.base.soup import is_soup
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from msb.asset import Asset

Wanted = Literal["auto", "kept", "fitted", "surface"]
LEAST_TEXTURE, MOST_TEXTURE = 16, MAX_SIDE


@dataclass(frozen=True)
class Options:
    """What is asked for of the faces and their colours, and what teaches: `msb.bake` says what each means.

    Raises
    ------
    UsageError
        USAGE: one is none, or they do not go together.
    """

    geometry: Wanted = "auto"
    for_solid: bool = False
    color: Look | None = None
    teacher: Source = "dedicated"
    faces: int | None = None
    texture: int | None = None
    seconds: float = 60.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value, words in (
            ("geometry", self.geometry, get_args(Wanted)),
            ("color", self.color, (None, *get_args(Look))),
            ("teacher", self.teacher, get_args(Source)),
        ):
            if value not in words:
                one_of = ", ".join(word for word in words if word)
                raise _refused(f'{name} is "{shorten(str(value), 40)}"; it must be one of {one_of}')
        if self.for_solid and self.geometry != "auto":
            text = f'for_solid chooses among what geometry "auto" makes; "{self.geometry}" is chosen already'
            raise _refused(text)
        if self.texture is not None:
            if not LEAST_TEXTURE <= self.texture <= MOST_TEXTURE:
                sides = f"{LEAST_TEXTURE} to {MOST_TEXTURE} texels a side"
                raise _refused(f"texture is {self.texture}; it must be {sides}")
            if self.color == "vertex":
                raise _refused("texture is the size of a texture, which color vertex has none of")
        if self.faces is not None and self.faces < 1:
            raise _refused(f"faces is {self.faces}; it must be 1 or more")
        if self.faces is not None and self.geometry == "kept":
            raise _refused("faces limits fitted ones; kept ones are the model's own")
        if not 0 <= self.seconds < float("inf"):
            raise _refused(f"seconds is {self.seconds}; it must be a finite number, 0 or more")
        if self.seed < 0:
            raise _refused(f"seed is {self.seed}; it must be 0 or more")

    def look(self, name: Geometry, asset: Asset) -> Look:
        """Return where the colours of a geometry go."""
        is_vertex = name == "kept" and self.texture is None and _fits_vertices(asset)
        return self.color or ("vertex" if is_vertex else "texture")

    def check_model(self, asset: Asset, *, has_levels: bool = False) -> None:
        """Refuse what would be found to be missing when most of the work is done."""
        is_auto = self.geometry == "auto" and self.faces is None and not self.for_solid
        if not (is_auto or self.geometry == "kept"):
            return
        faces = asset.buffers["indices"]
        if self.look("kept", asset) == "texture" and not is_soup(faces):
            need_xatlas()
        if has_levels and not is_uncut_soup(asset.buffers["positions"], faces):
            need_simplification()


def _fits_vertices(asset: Asset) -> bool:
    """Return whether colours at the corners can be what is seen: not of what has its look within each face;
    nor of a mesh whose faces have colours of their own, if there is what makes a texture."""
    if why_not(asset.manifest, "standard") is not None:
        return False
    tint = tint_of(asset)
    is_unshared = is_soup(asset.buffers["indices"])
    is_smooth = tint is not None and (is_unshared or tint.domain == "vertex")
    return (is_smooth and textures_of(asset) is None) or not (is_unshared or is_installed("xatlas"))


def need_libraries(geometry: str) -> None:
    """Refuse a geometry whose libraries are not installed."""
    if geometry == "surface":
        need_extra("bench", "skimage", what="a closed surface")
        need_extra("trial", "fast_simplification", "xatlas", what="a closed surface")


def _refused(text: str) -> UsageError:
    return UsageError("USAGE", text)
