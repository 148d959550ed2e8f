"""Levels of detail, collision shapes, names and packages for a mesh that keeps its texture.

`scene` reads the triangles of a glTF document, `simplification` reduces them, `rewriting` writes the document
with other faces, `quality` compares images, and `collision` makes the shape. `run` does all of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.lod.report import Report
    from msb.lod.run import Lods, lod

__all__ = ["Lods", "Report", "lod"]

make_lazy(__name__, {"Lods": "msb.lod.run", "Report": "msb.lod.report", "lod": "msb.lod.run"})
