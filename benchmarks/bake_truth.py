"""Measure the PSNR of the true surfaces of the demo scenes with the best static colours.

    python -m benchmarks.bake_truth

The vertex colours of the true surface are fitted to native renderings of a demo model, as in a bake. The
result is compared with held-out photographs, with 16 samples per pixel. A baked surface with a higher PSNR
has dents that imitate highlights, because its colours do not change with the view.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack, closing
from pathlib import Path

import msb
from benchmarks.bake import DEMO, read, write_truths
from benchmarks.measure import keep, machine
from msb.asset.origin import without_origin
from msb.bake.image_source import SAMPLES_PER_SIDE, ImageSource
from msb.bake.quality import measure_psnr
from msb.bake.vertex_colors import fit_vertex_colors
from msb.bake.views import choose_bake_views
from msb.base.origin import NO_ORIGIN
from msb.meshes.assets import asset_from_mesh, mesh_from_asset

# Scale of the training images relative to the views, as in a bake of small views.
_SCALE = 4


def measure_true_surface(model: Path, scene_path: Path, truth: str) -> float:
    """Return the PSNR in dB of a true surface with colours fitted to the native renderings of a model."""
    asset, scene = without_origin(msb.open(model)), read(model, scene_path, {})
    views = choose_bake_views(asset, scene)
    mesh = mesh_from_asset(msb.open(truth))
    with ExitStack() as stack:
        source = stack.enter_context(ImageSource(asset, views))
        images = stack.enter_context(closing(source.training_images(views.all_but_test, _SCALE)))
        pixels = max(camera.width * camera.height for camera in views.test)
        colored = asset_from_mesh(
            fit_vertex_colors(mesh, images.with_coarser_levels(pixels), None), origin=NO_ORIGIN
        )
        photographs = stack.enter_context(closing(source.photographs(views.test)))
        return measure_psnr(colored, [photographs], SAMPLES_PER_SIDE, None)[0]


def main() -> None:
    """Print and keep the PSNR of the demo models."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=DEMO, default=DEMO, metavar="NAME")
    parser.add_argument("--folder", type=Path, required=True, help="write the true surfaces here")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    truths = write_truths(options.folder)
    rows = []
    for name in options.only:
        model, scene = DEMO[name]
        value = measure_true_surface(model, scene, truths[scene])
        rows.append({"model": name, "true_surface_db": value})
        print(f"{name}: {value:.2f} dB", flush=True)
    what = (
        "PSNR in dB of the true surfaces of the demo scenes with static colours that were fitted to native "
        "renderings, compared with held-out photographs at 16 samples per pixel"
    )
    keep({"what": what, "machine": machine("numpy", "pyopencl"), "rows": rows}, options.json)


if __name__ == "__main__":
    main()
