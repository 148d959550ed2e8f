"""Time a frame of a Gaussian splat, beside gsplat's torch functions: `python -m benchmarks.splats SPLAT`.

Both draw the same view of the same file on the CPU, with the rules of gsplat, and take turns within a round.
gsplat's own functions are spherical harmonics, projection and compositing (gsplat/cuda/_torch_impl.py). The
search for the pixels of each Gaussian needs CUDA in gsplat, and so does nerfacc, which the compositing calls.
This module has torch functions in their place. The search is done once. One ratio includes the search, the
other ratio does not.

The peer is optional: `pip install torch gsplat`. Without it, our renderer is timed alone.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
import types
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.dedicated import BLACK, WARM_UP
from benchmarks.measure import keep, machine

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera

SETTINGS = {"rasterizer": "gsplat"}
TILE = 16
MIN_ALPHA, MIN_TRANSMITTANCE = 1 / 255, 1e-4
MIN_PSNR = 40.0
"""Agreement of both images in dB. gsplat's compositing limits alpha to 0.999, all its kernels to 0.99."""


def load_gsplat() -> Any:
    """Return gsplat's module of torch functions, or None without torch or gsplat.

    The package itself is not imported, because it compiles CUDA code.
    """
    try:
        path = distribution("gsplat").locate_file("gsplat/cuda/_torch_impl.py")
    except PackageNotFoundError:
        return None
    if importlib.util.find_spec("torch") is None:
        return None
    nerfacc = types.ModuleType("nerfacc")
    vars(nerfacc).update(render_weight_from_alpha=weigh, accumulate_along_rays=add_up)
    sys.modules["nerfacc"] = nerfacc
    spec = importlib.util.spec_from_file_location("gsplat_torch_functions", str(path))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def weigh(alphas: Any, ray_indices: Any, n_rays: int) -> tuple[Any, Any]:
    """Return weights and transmittances of samples (M,), which are sorted by ray and by depth."""
    import torch

    logarithm = torch.log1p(-alphas.double())
    before = torch.cumsum(logarithm, 0) - logarithm
    starts = torch.ones_like(ray_indices, dtype=torch.bool)
    starts[1:] = ray_indices[1:] != ray_indices[:-1]
    first = before[starts][torch.cumsum(starts, 0) - 1]
    through = torch.exp(before - first).to(alphas.dtype)
    return alphas * through, through


def add_up(weights: Any, values: Any, ray_indices: Any, n_rays: int) -> Any:
    """Return the sum of weights times values (M, C) of each ray, (`n_rays`, C)."""
    terms = weights[:, None] if values is None else weights[:, None] * values
    return terms.new_zeros((n_rays, terms.shape[1])).index_add_(0, ray_indices, terms)


def meet(means: Any, conics: Any, radii: Any, depths: Any, opacities: Any, width: int, height: int) -> Any:
    """Return Gaussians and pixels (M,) that meet, by pixel and by depth, up to the stop of each pixel."""
    import torch

    columns, rows = -(-width // TILE), -(-height // TILE)
    grid = torch.tensor([columns, rows])
    low = torch.minimum(torch.floor((means - radii) / TILE).clamp_min(0), grid).long()
    high = torch.minimum(torch.ceil((means + radii) / TILE).clamp_min(0), grid).long()
    kept = torch.nonzero((radii > 0).all(1) & (high > low).all(1))[:, 0]
    kept = kept[torch.argsort(depths[kept], stable=True)]
    # Pairs of a Gaussian and a tile, sorted by tile and by depth.
    extent = (high - low)[kept]
    counts = extent.prod(1)
    listed = torch.repeat_interleave(torch.arange(len(kept)), counts)
    within = torch.arange(len(listed)) - torch.repeat_interleave(torch.cumsum(counts, 0) - counts, counts)
    across = low[kept][listed, 0] + within % extent[listed, 0]
    tile = (low[kept][listed, 1] + within // extent[listed, 0]) * columns + across
    order = torch.argsort(tile, stable=True)
    tiles, sizes = torch.unique_consecutive(tile[order], return_counts=True)
    found, end = [], 0
    for number, size in zip(tiles.tolist(), sizes.tolist(), strict=True):
        faces = kept[listed[order[end : end + size]]]
        end += size
        x0, y0 = TILE * (number % columns), TILE * (number // columns)
        x, y = torch.arange(x0, min(x0 + TILE, width)), torch.arange(y0, min(y0 + TILE, height))
        # Alpha of each Gaussian (rows) at each pixel of the tile (columns).
        dx = (x + 0.5)[None, None] - means[faces, 0][:, None, None]
        dy = (y + 0.5)[None, :, None] - means[faces, 1][:, None, None]
        a, b, c = conics[faces].T[..., None, None]
        sigma = (0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy).flatten(1)
        alpha = (opacities[faces][:, None] * torch.exp(-sigma)).clamp_max(0.99)
        seen = (sigma >= 0) & (alpha >= MIN_ALPHA)
        seen &= torch.cumprod(torch.where(seen, 1 - alpha, 1.0), 0) > MIN_TRANSMITTANCE
        place, rank = torch.nonzero(seen.T, as_tuple=True)
        found.append((faces[rank], (y[:, None] * width + x).flatten()[place]))
    ids, pixels = (torch.cat(parts) for parts in zip(*found, strict=True))
    order = torch.argsort(pixels, stable=True)
    return ids[order], pixels[order]


def prepare_gsplat(functions: Any, asset: Asset, camera: Camera) -> tuple[Callable[[], Any], float]:
    """Return a function that draws a frame with pixels that are known, and the seconds of their search."""
    import torch

    from msb.asset.activation import rest_coefficients
    from msb.splats.primitive import MEAN, ROTATION, SCALE

    degree, buffers = asset.manifest.sh_degree or 0, asset.buffers
    sh = [buffers["f_dc"].reshape(-1, 1, 3)] + ([rest_coefficients(asset)] if degree else [])
    coefficients = torch.from_numpy(np.concatenate(sh, axis=1))
    torch.set_grad_enabled(False)
    mean, rotation, scale = (torch.from_numpy(buffers[name].copy()) for name in (MEAN, ROTATION, SCALE))
    opacity = torch.from_numpy(buffers["opacity"].reshape(-1).copy()).sigmoid()
    view = torch.from_numpy(camera.world_to_camera.astype(np.float32))
    matrix = torch.tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    center = torch.linalg.inv(view)[:3, 3]
    width, height = camera.width, camera.height

    def project() -> tuple[Any, ...]:
        color = functions._spherical_harmonics(degree, mean - center, coefficients).add(0.5).clamp_min(0)
        covariance, _ = functions._quat_scale_to_covar_preci(rotation, scale.exp(), compute_preci=False)
        args = mean, covariance, view[None], matrix[None], width, height
        return (color, *(part[0] for part in functions._fully_fused_projection(*args)[:4]))

    _, radii, means, depths, conics = project()
    start = time.process_time()
    ids, pixels = meet(means, conics, radii, depths, opacity, width, height)
    seconds = time.process_time() - start

    def draw() -> Any:
        color, _, means, _, conics = project()
        rows = means[None], conics[None], opacity[None], color[None]
        return functions.accumulate(*rows, ids, pixels, 0 * ids, width, height)[0][0].numpy()

    return draw, seconds


def measure(path: Path, width: int, height: int, rounds: int) -> dict[str, Any]:
    """Return the row of one splat: medians over rounds, and the median of the ratios within a round."""
    import msb
    from msb.cl import open_device
    from msb.metrics import psnr
    from msb.render.splat.pipeline import SplattingPipeline
    from msb.scenes.around import make_turntable

    asset, functions = msb.open(path), load_gsplat()
    camera = make_turntable(asset, 1, width, height)[0]
    with open_device("cpu") as device:
        ours = SplattingPipeline(asset, device=device, settings=SETTINGS, outputs=())
        for _ in range(WARM_UP):
            ours.draw(camera, BLACK)
        image = ours.render(camera, BLACK).image
        theirs, search = prepare_gsplat(functions, asset, camera) if functions else (None, 0.0)
        if theirs:
            agreement = psnr(np.clip(theirs(), 0, 1), np.clip(image, 0, 1))
            assert agreement > MIN_PSNR, "only equal images can be compared"
        spans, took = [], []
        for _ in range(rounds):
            start = time.process_time()
            spans.append(ours.draw(camera, BLACK).span)
            middle = time.process_time()
            if theirs:
                theirs()
            took.append((1e3 * (middle - start), 1e3 * (time.process_time() - middle)))
        ours.close()
    row: dict[str, Any] = {
        "splat": path.name,
        "Gaussians": asset.manifest.face_count,
        "size": f"{width}x{height}",
        "elapsed ms": round(median(spans), 1),
        "least elapsed ms": round(min(spans), 1),
        "ms": round(median(own for own, _ in took), 1),
    }
    if theirs:
        row["gsplat ms"] = round(median(other for _, other in took))
        row["gsplat / ours"] = round(median(other / own for own, other in took), 1)
        row["with search / ours"] = round(median((1e3 * search + other) / own for own, other in took))
        row["search s"] = round(search, 1)
        row["PSNR dB"] = round(agreement, 1)
    return row


def main() -> None:
    """Print a line for each splat."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("splats", type=Path, nargs="+", metavar="SPLAT", help="a file of Gaussians")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    rows = []
    for path in options.splats:
        rows.append(measure(path, options.size[0], options.size[1], options.rounds))
        print(*(f"{name}: {value}" for name, value in rows[-1].items()), sep="\n", flush=True)
    keep(
        {
            "what": "A frame of a Gaussian splat on the CPU, beside gsplat's torch functions: medians of "
            f"{options.rounds} rounds in processor time of all threads, which does not depend on other load. "
            "gsplat has its SH, projection and compositing; search s has our torch function in place of its "
            "CUDA search for pixels, once",
            "machine": machine("numpy", "pocl-binary-distribution", "torch", "gsplat"),
            "rows": rows,
        },
        options.json,
    )


if __name__ == "__main__":
    main()
