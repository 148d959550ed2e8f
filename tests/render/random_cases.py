"""Random cases for property tests of renderers: one seed gives a model, settings, camera and background.

Difficult values are likely: settings at their limits, images of one pixel, principal points far off the
middle, and fields of view from 1 to 170 degrees. Faces may coincide, have no area, or all be behind the
camera.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.registry import METHODS, ORDERS, SAMPLINGS
from msb.render.frame import EXTRAS
from msb.scenes import Camera
from tests.reference.soups import SPLATTING, lattice_model, soup, weld
from tests.render.standard_scenes import mesh_asset, random_colors, unshared

Random = np.random.Generator
Triangles = NDArray[np.float64]
Floats = NDArray[np.float32]

KINDS = (
    "mixed",
    "layers",
    "connected",
    "coincident",
    "equal depths",
    "aligned",
    "slivers",
    "degenerate",
    "tiny",
    "huge",
    "scaled",
    "around",
    "behind",
)
"""Kinds of triangle sets that `draw_triangles` can generate."""
STANDARD = "standard"
"""The name in place of a method, for cases with assets of any kind that the standard tier supports."""
FACES = 90


@dataclass(frozen=True)
class Case:
    """A random case. The `str` of a case identifies it, because the buffers follow from the seed."""

    method: str
    seed: int
    kind: str
    asset: Asset
    camera: Camera
    background: tuple[float, float, float]
    settings: dict[str, Any]
    options: dict[str, Any]
    """Options of the renderer; `order` and `sampling` also apply to the reference."""
    style: str
    """Style of the kernels."""

    def __str__(self) -> str:
        camera = self.camera
        lens = f"f {camera.fx:.4g} {camera.fy:.4g} c {camera.cx:.4g} {camera.cy:.4g}"
        return (
            f"{self.method} seed {self.seed}: {self.kind}, {camera.width}x{camera.height} {lens}, "
            f"{self.settings}, {self.options}, {self.style} style"
        )


def draw_case(method: str, seed: int) -> Case:
    """Return the case of `seed` for a method with a native renderer, or for `STANDARD`."""
    random = np.random.default_rng((seed, *method.encode()))
    kind = str(random.choice(KINDS))
    camera = draw_camera(random, aligned=kind == "aligned")
    triangles = to_world(draw_triangles(random, kind, camera), camera)
    drawn_as = method
    if method == STANDARD:
        drawn_as = str(random.choice(["mesh", *SPLATTING]))
    settings = draw_settings(random, drawn_as)
    if drawn_as == "mesh":
        asset = draw_mesh(random, triangles)
    elif method == "diffsoup":
        asset = draw_lattice(random, triangles)
    else:
        asset = draw_splats(random, drawn_as, triangles, settings)
    options: dict[str, Any] = {}
    if method == STANDARD:
        settings = {name: value for name, value in settings.items() if name == "ste_threshold"}
        options["supersample"] = int(random.choice([1, 1, 1, 2, 3, 4]))
    else:
        options["order"] = str(random.choice([ORDERS[0], *ORDERS]))
        options["sampling"] = str(random.choice([SAMPLINGS[0], *SAMPLINGS]))
        few = [str(random.choice(EXTRAS))] if random.random() < 0.5 else []
        options["outputs"] = few if random.random() < 0.3 else "all"
    if method in SPLATTING:
        options["early_stop"], options["exact_tiles"] = (bool(random.random() < 0.7) for _ in "ab")
    background = random.choice([0.0, 1.0, *random.uniform(0, 1, 3)], 3)
    return Case(
        method=method,
        seed=seed,
        kind=kind,
        asset=asset,
        camera=camera,
        background=tuple(background.tolist()),
        settings=settings,
        options=options,
        style=str(random.choice(["cpu", "gpu"])),
    )


def draw_settings(random: Random, method: str) -> dict[str, Any]:
    """Return a random value for every setting of `method`. The value can be a limit of the setting."""
    choices: dict[str, list[Any]] = {
        "rasterizer": ["2D", "3D"],
        "sh_degree": [0, 1, 2, 3],
        "gamma": [1.0, 1.0, 1.5, 7.5, 50.0, 1000.0],
        "back_culling": [False, True],
        "gamma_rescale": [False, True],
        "ste_threshold": [None, None, 0.0, 0.4, 1.0],
        "render_up_scale": [None, 1, 2, 3, 4, 5],
        "view_dir": ["broadcast_z", "centroid"],
        "supersample": [1, 1, 2, 3, 4, 7],
        "opacity_floor": [0.0, 0.0, 0.1, 0.999, 1.0],
        "sigma": [1e-4, 1e-4, 0.3, 1.0, 5.0, 300.0],
        "layout": ["colmap", "synthetic"],
        "z_near": [0.5, 0.01, 0.1, 3.0],
        "z_far": [100.0, 10.0, 1000.0],
    }
    return {name: choices[name][random.integers(len(choices[name]))] for name in METHODS[method].settings}


def draw_camera(random: Random, *, aligned: bool) -> Camera:
    """Return a random camera of at least 1 x 1 pixels; if `aligned`, pixels have round coordinates."""
    width, height = (int(random.choice([1, 2, 15, 16, 17, 33, 48, random.integers(3, 60)])) for _ in "xy")
    if aligned:
        return Camera(width, height, 32.0, 32.0, width / 2, height / 2, np.eye(4))
    # Half of the field of view is 0.5 to 85 degrees. Pixels are up to three times as wide as high.
    focal = max(width, height) / 2 / np.exp(random.choice([0.0, random.uniform(-4.5, 2.4)]))
    ratio = float(np.exp(random.choice([0.0, random.uniform(-1, 1)])))
    middle = np.array([width, height]) / 2
    off = random.choice([0.0, 0.2, 1.5], p=[0.4, 0.4, 0.2])
    cx, cy = middle + off * np.array([width, height]) * random.uniform(-1, 1, 2)
    pose = np.eye(4)
    if random.random() < 0.8:
        turned = np.linalg.qr(random.normal(size=(3, 3)))[0]
        pose[:3, :3] = turned * np.sign(np.linalg.det(turned))
        pose[:3, 3] = random.normal(size=3) * random.choice([0.0, 1.0, 30.0, 3000.0])
    return Camera(width, height, focal, focal * ratio, float(cx), float(cy), pose)


def to_world(triangles: Triangles, camera: Camera) -> Floats:
    """Return triangles (F, 3, 3) transformed from camera space to the world."""
    pose = camera.world_to_camera
    return np.asarray((triangles - pose[:3, 3]) @ pose[:3, :3], np.float32)


def draw_triangles(random: Random, kind: str, camera: Camera) -> Triangles:
    """Return triangles (F, 3, 3) in camera space, most of them in the field of view."""
    count = int(random.integers(1, FACES))
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
    middle = (np.array([camera.width, camera.height]) / 2 - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    if kind == "aligned":
        # Corners on centres and borders of pixels, edges along rows and columns, depths as powers of two.
        pixels = random.integers(-4, 2 * np.array([camera.width, camera.height]) + 4, (count, 3, 2)) / 2
        pixels[::2, 1, 0], pixels[::2, 2, 1] = pixels[::2, 0, 0], pixels[::2, 0, 1]
        depth = 2.0 ** random.integers(0, 4, (count, 1, 1))
        flat = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy) * depth
        return np.concatenate([flat, np.broadcast_to(depth, (count, 3, 1))], axis=2)
    nearest, farthest = ((0.15, 60), (1.1, 8), (4, 4.001))[random.integers(3)]
    depth = np.exp(random.uniform(np.log(nearest), np.log(farthest), count))
    pixel = 2 / max(camera.width, camera.height)
    least, most = {"tiny": (0.2 * pixel, 4 * pixel), "huge": (3, 300)}.get(kind, (0.004, 3))
    size = np.exp(random.uniform(np.log(least), np.log(most), count))
    if kind == "layers":
        depth, size = np.sort(depth), np.full(count, random.choice([0.5, 3.0, 30.0]))
    shape = random.normal(size=(count, 3, 3)) * size[:, None, None]
    shape[..., 2] *= random.choice([0.0, 0.01, 0.3])
    place = random.uniform(-1.2, 1.2, (count, 1, 2))
    # Corners relative to half the size of the image, and multiplied by the depth.
    flat = middle + half * (place + shape[..., :2])
    z = depth[:, None] * (1 + shape[..., 2])
    if kind == "equal depths":
        z[:] = random.choice([1.5, 2.0, 7.7], (count, 1))
    elif kind == "around":
        z = random.normal(scale=3, size=(count, 1)) + shape[..., 2] * depth[:, None]
    placed = np.concatenate([flat * np.abs(z)[..., None], z[..., None]], axis=2)
    if kind == "behind":
        placed[..., 2] = -np.abs(placed[..., 2])
    elif kind == "slivers":
        thin = 10.0 ** random.uniform(-6, -0.3, (count, 1))
        placed[:, 2] = placed[:, 1] + (placed[:, 2] - placed[:, 0]) * thin
    elif kind == "degenerate":
        placed[::4, 2] = placed[::4, 1]
        placed[1::4, 2] = (placed[1::4, 0] + placed[1::4, 1]) / 2
        placed[2::8] = placed[2::8, :1]
    elif kind == "scaled":
        placed[::3] *= 10.0 ** random.uniform(-6, 6, (len(placed[::3]), 1, 1))
    elif kind == "coincident":
        placed = placed[random.integers(0, 1 + count // 4, count)]
        turned = random.integers(0, 3, count)
        placed = np.stack(
            [np.roll(corners, turn, axis=0) for corners, turn in zip(placed, turned, strict=True)]
        )
    elif kind == "connected":
        # Triangles share corners.
        corners = placed.reshape(-1, 3)[: count + 2]
        placed = corners[random.integers(0, len(corners), (count, 3))]
    return placed


def logits(random: Random, count: int) -> Floats:
    """Return opacity logits from one of several distributions, some with infinite values."""
    usual = random.normal(1, 3, count)
    choices = {
        "usual": usual,
        "faint": random.uniform(-6, -4, count),  # 1/255 is at -5.5
        "opaque": random.uniform(4, 30, count),
        "extreme": random.choice([-np.inf, -200, -88.8, 0, 16.6, 88.8, np.inf], count),
        "one for all": np.full(count, usual[0]),
    }
    return choices[str(random.choice(list(choices)))].astype(np.float32)


def draw_splats(random: Random, method: str, triangles: Floats, settings: dict[str, Any]) -> Asset:
    """Return a model of a splatting method with at least the SH degree of the settings."""
    welded = bool(random.random() < 0.5)
    rows = len(triangles)
    if method == "mesh_splatting":
        rows = len(weld(triangles)[0]) if welded else 3 * rows
    buffers = {"opacity": logits(random, rows)}
    if method == "triangle_splatting":
        low, high = ((-3, 0.5), (-12, 4), (-60, -20))[random.integers(3)]
        buffers["sigma"] = random.uniform(low, high, rows).astype(np.float32)
    degree = int(random.integers(settings["sh_degree"], 4))
    seed = int(random.integers(1 << 30))
    return soup(method, triangles, seed=seed, degree=degree, welded=welded, **buffers)


def draw_lattice(random: Random, triangles: Floats) -> Asset:
    """Return a model of DiffSoup; its settings are passed to the renderer."""
    level = int(random.integers(0, 5))
    samples = (2**level + 1) * (2**level + 2) // 2
    opacity = {
        "usual": None,
        "opaque": np.ones((len(triangles), samples)),
        "around a half": 0.5 + random.choice([-1e-3, -6e-8, 0, 1e-3], (len(triangles), samples)),
    }
    return lattice_model(
        *weld(triangles),
        level,
        seed=int(random.integers(1 << 30)),
        opacity=opacity[str(random.choice(list(opacity)))],
        quantised=bool(random.random() < 0.3),
    )


def draw_mesh(random: Random, triangles: Floats) -> Asset:
    """Return a mesh with colours of any domain and type, or without colours."""
    mesh = weld(triangles) if random.random() < 0.5 else unshared(triangles)
    rows = {"vertex": len(mesh[0]), "face": len(mesh[1]), "corner": mesh[1].size}
    domain = str(random.choice(list(rows)))
    dtype = (np.uint8, np.float32)[random.integers(2)]
    colors = random_colors(int(random.integers(1 << 30)), rows[domain], dtype)
    if random.random() < 0.1:
        return mesh_asset(mesh)
    return mesh_asset(mesh, colors, domain)
