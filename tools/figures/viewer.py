"""Create images of the viewers with the demo asset: `python -m tools.figures.viewer` (extra: view)."""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import msb
from msb.topology import audit_arrays
from msb_viewers.deployment.compose import compose as compose_tiers
from msb_viewers.deployment.shots import Comparison, TierRenderers, choose_tiers
from msb_viewers.deployment.state import CompareState, Layout
from msb_viewers.deployment.views import View
from msb_viewers.figure import compose, render_columns
from msb_viewers.model import ViewModel, build_model
from msb_viewers.repaired import build_repaired_model
from msb_viewers.state import ViewState
from msb_viewers.viewed_mesh import read_viewed_mesh
from msb_viewers.viewer import TopologyViewer

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
STUBS = ROOT / "data_stubs"
ASSET = STUBS / "splat_like.triasset"
TRAINED = STUBS / "models" / "pebble" / "triangle_splatting"
SCENE = STUBS / "scenes" / "nerf_synthetic" / "pebble"
GAP = 12
"""Largest height of an empty band of an image, in pixels."""
SHADES = 5
"""Bits per channel in the figure. The file has a third of the bytes, without a visible change."""


def demo_model() -> ViewModel:
    """Return the demo asset as the viewer's model."""
    mesh = read_viewed_mesh(ASSET)
    return build_model(mesh, *audit_arrays(mesh.vertices, mesh.faces, attributes=mesh.attributes))


def viewer_picture(model: ViewModel) -> Image.Image:
    """Return the viewer at a non-manifold edge. It shows the fans of one end of the edge."""
    state = ViewState.first(model)
    state.visible = {"nonmanifold_edges", "multifan_vertices", "nonmanifold_edge_endpoints"}
    viewer = TopologyViewer(model, off_screen=True, state=state)
    try:
        # Choose a vertex of both kinds at the front, with few fans.
        fans = model.analysis.fans
        both = (fans.groups_per_vertex > 1) & (fans.fans_per_vertex >= 4) & (fans.fans_per_vertex <= 6)
        both &= np.isin(np.arange(len(both)), model.layers["nonmanifold_edge_endpoints"].numbers)
        near = np.where(both, model.points @ viewer.pose.eye, -np.inf)
        state.choose_vertex(int(near.argmax()))
        viewer.fly_to_selection()
        return Image.fromarray(viewer.image())
    finally:
        viewer.close()


def figure_picture(model: ViewModel) -> Image.Image:
    """Return the figure of four panels for a README."""
    buffer = io.BytesIO()
    compose(model, render_columns(model)).savefig(buffer, format="png", dpi=78, facecolor="white")
    pixels = np.asarray(Image.open(buffer).convert("RGB"))
    step = 1 << (8 - SHADES)
    return Image.fromarray(np.where(pixels == 255, 255, pixels // step * step + step // 2).astype(np.uint8))


def compare_picture(layout: Layout, size: tuple[int, int]) -> Image.Image:
    """Return the deployment viewer at a held-out view of a trained model.

    It shows render times of this machine.
    """
    asset = msb.open(TRAINED)
    camera = msb.read_cameras(SCENE / "transforms_test.json")[0].scaled(2)
    view = View(str(camera.name), camera)
    tiers, missing = choose_tiers(asset, [], None)
    comparison = Comparison("pebble.triasset", asset, tiers, missing, views=(view,))
    state = CompareState.first(comparison, layout=layout)
    with TierRenderers(state.comparison) as renderers:
        renderers.shoot_all(view, state.wanted_tiers())  # before timing: the first frame is slow
        shots = renderers.shoot_all(view, state.wanted_tiers())
    return Image.fromarray(compose_tiers(state, shots, size).image)


def shorten_empty_bands(picture: Image.Image) -> Image.Image:
    """Return the image with at most `GAP` rows of each band of rows in one colour."""
    pixels = np.asarray(picture)
    is_empty = (pixels == pixels[:, :1]).all(axis=(1, 2))
    # Number of empty rows up to each row, counted from the last row that is not empty.
    rows = np.arange(len(pixels))
    run = rows - np.maximum.accumulate(np.where(is_empty, -1, rows))
    return Image.fromarray(pixels[run <= GAP])


def repaired_picture() -> Image.Image:
    """Return the image of `msb view --repaired` with the demo asset without debris and small holes."""
    before = read_viewed_mesh(ASSET)
    plan = ["orient", "pair", "debris", "close"]
    done = msb.repair(ASSET, plan, debris_faces=2).asset
    after = replace(
        before, name="repaired.triasset", vertices=done.buffers["positions"], faces=done.buffers["indices"]
    )
    model = build_repaired_model(before, after)
    state = ViewState.first(model)
    state.visible = set(model.layers)
    viewer = TopologyViewer(model, size=(1000, 700), off_screen=True, state=state)
    try:
        return Image.fromarray(viewer.image()).quantize(128, dither=Image.Dither.NONE)
    finally:
        viewer.close()


def tutorial_picture() -> Image.Image:
    """Return the image written by `msb compare` in the guide."""
    with tempfile.TemporaryDirectory() as folder:
        asset, picture = Path(folder) / "pebble.triasset", Path(folder) / "compare.png"
        msb.save(msb.open(STUBS / "models" / "walled" / "mesh_splatting"), asset)
        options = ["--camera", "DSC07950", "--screenshot", str(picture), "--size", "1000x760"]
        command = [sys.executable, "-m", "msb", "compare", *options]
        scene = STUBS / "scenes" / "mipnerf360" / "pebble"
        subprocess.run(
            [*command, "--cameras", str(scene), "--image-folder", "images_4", str(asset)], check=True
        )
        return Image.open(picture).convert("RGB")


if __name__ == "__main__":
    demo = demo_model()
    viewer_picture(demo).save(IMAGES / "viewer.png", optimize=True)
    figure_picture(demo).save(IMAGES / "viewer_topology.png", optimize=True)
    side = shorten_empty_bands(compare_picture("side", (1000, 640)))
    side.save(IMAGES / "viewer_side.png", optimize=True)
    compare_picture("difference", (900, 680)).save(IMAGES / "viewer_difference.png", optimize=True)
    repaired_picture().save(IMAGES / "viewer_repaired.png", optimize=True)
    tutorial_picture().save(IMAGES / "tutorial.png", optimize=True)
