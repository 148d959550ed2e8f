"""Compare the sizes of GLB files in bytes: earlier files, files of today, and files for the web.

Measure the image quality of the web files.

    python -m benchmarks.delivery [--json FILE] [ASSET ...]

prints a row of Markdown for each asset. Quality is measured with 1 and 16 samples per pixel. If an edge moves
by a hundredth of a pixel, a hundredth of the pixels along the edge show another face. With 16 samples per
pixel, such a pixel changes by only a sixteenth.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import Any

import msb
from benchmarks.measure import keep, machine
from msb.delivery.web_quality import ImageLoss, encode_and_read, web_style
from msb.meshes import Mesh, write_mesh
from msb.meshes.assets import fit_to_format, mesh_from_asset
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
    """Return the size of the GLB of earlier versions, which stored sRGB colours.

    Its JSON of 1 kB is not counted.
    """
    colors = mesh.vertex_colors
    width = 0 if colors is None else 4 if colors.dtype.itemsize == 1 else 4 * colors.shape[1]
    return len(mesh.vertices) * (12 + width) + len(mesh.faces) * 12


def size(mesh: Mesh, style: Style) -> int:
    """Return the size of a GLB in bytes."""
    file = io.BytesIO()
    write_mesh(fit_to_format(mesh, ".glb"), file, suffix=".glb", style=style)
    return len(file.getvalue())


def measure(path: str) -> dict[str, Any]:
    """Return the row of one asset: the sizes in bytes, and the PSNR in dB of the web encoding with 1 and 16
    samples.
    """
    asset = msb.open(path)
    mesh = mesh_from_asset(asset)
    loss = ImageLoss.of(mesh, asset)
    style, _ = web_style(loss)
    encoded = encode_and_read(mesh, style)
    kept = [loss.loss(encoded, samples) for samples in (1, 4)]
    name = "/".join(Path(path).parts[-2:])
    sizes = {"before": before(mesh), "glb": size(mesh, Style()), "web": size(mesh, style)}
    return {"asset": name, **sizes, "db_1_sample": kept[0], "db_16_samples": kept[1]}


def line(row: dict[str, Any]) -> str:
    """Return a row in Markdown."""
    numbers = " | ".join(f"{row[key]:,}" for key in ("before", "glb", "web"))
    share = f"{100 * row['web'] / row['before']:.1f} %"
    return f"| {row['asset']} | {numbers} | {share} | {row['db_1_sample']:.1f} | {row['db_16_samples']:.1f} |"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("assets", nargs="*", metavar="ASSET", default=ASSETS)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    print(HEADER)
    rows = []
    for name in options.assets:
        rows.append(measure(name))
        print(line(rows[-1]), flush=True)
    keep({"machine": machine("numpy"), "rows": rows}, options.json)


if __name__ == "__main__":
    main()
