"""Bytes of GLB files as they were, as they are, and for the web; and what their pictures keep.

    python -m benchmarks.delivery [ASSET ...]

prints a row of Markdown for each asset. With one sample a pixel an edge that moves by a hundredth of a pixel
turns a hundredth of its pixels over; with sixteen it is seen as that much less.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

import msb
from msb.delivery import pictures as delivered
from msb.delivery.pictures import Pictures, web_style
from msb.meshes import Mesh, write_mesh
from msb.meshes.assets import as_held, mesh_from_asset
from msb.meshes.formats import Style

ASSETS = (
    "data_stubs/splat_like.triasset",
    "data_stubs/models/walled/mesh_splatting",
    "data_stubs/models/pebble/mesh_splatting",
    "data_stubs/models/walled/triangle_splatting",
    "data_stubs/models/pebble/triangle_splatting",
    "data_stubs/models/pebble/two_dts",
)
HEADER = """| asset | before | GLB | web | of before | dB, 1 sample | dB, 16 samples |
|---|---|---|---|---|---|---|"""


def before(mesh: Mesh) -> int:
    """Return the bytes of the GLB that was written until colours became linear, without its JSON of 1 kB."""
    colors = mesh.vertex_colors
    width = 0 if colors is None else 4 if colors.dtype.itemsize == 1 else 4 * colors.shape[1]
    return len(mesh.vertices) * (12 + width) + len(mesh.faces) * 12


def size(mesh: Mesh, style: Style) -> int:
    """Return the bytes of a GLB."""
    file = io.BytesIO()
    write_mesh(as_held(mesh, ".glb"), file, suffix=".glb", style=style)
    return len(file.getvalue())


def row(path: str) -> str:
    """Return the row of one asset."""
    asset = msb.open(path)
    mesh = mesh_from_asset(asset)
    pictures = Pictures.of(mesh, asset)
    style, _ = web_style(pictures)
    written = delivered.written(mesh, style)
    kept = [pictures.loss(written, samples) for samples in (1, 4)]
    old, web = before(mesh), size(mesh, style)
    share = f"{100 * web / old:.1f} %"
    numbers = " | ".join(f"{count:,}" for count in (old, size(mesh, Style()), web))
    return f"| {'/'.join(Path(path).parts[-2:])} | {numbers} | {share} | {kept[0]:.1f} | {kept[1]:.1f} |"


if __name__ == "__main__":
    print(HEADER)
    for name in sys.argv[1:] or ASSETS:
        print(row(name), flush=True)
