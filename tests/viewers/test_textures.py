"""Textures in the window and on the page, compared with the standard tier."""

import io
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from msb.api.opening import stored_mesh
from msb.asset.texture import Sampler
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.topology import audit_arrays
from msb_viewers.camera import FOV_Y, Pose
from msb_viewers.model import ViewModel, build_model
from msb_viewers.page import page
from msb_viewers.palette import BACKGROUND
from msb_viewers.state import ViewState
from msb_viewers.viewed_mesh import viewed_mesh
from msb_viewers.viewer import TopologyViewer
from tests.viewers.test_page import parts

EYE = np.array([0.2, 0.1, 2.6])


def textured(sampler: Sampler, **more: Any) -> msb.Asset:
    """Return two squares with two textures and texture coordinates far outside 0 to 1."""
    x, y = np.meshgrid([-1.0, 0.0, 1.0], [-0.6, 0.6])
    points = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32)
    faces = np.array([[0, 1, 3], [1, 2, 4], [1, 4, 3], [2, 5, 4]])
    images = np.random.default_rng(3).integers(0, 256, (2, 8, 4, 4), np.uint8)
    numbers = np.array([0, 1, 0, 1], np.uint32)
    uvs = (points[:, :2] * (1.3, 2.2) + 0.4).astype(np.float32)
    mesh = Mesh(points, faces, vertex_uvs=uvs, textures=tuple(images), face_textures=numbers, sampler=sampler)
    return asset_from_mesh(replace(mesh, **more))


def model_of(asset: msb.Asset) -> ViewModel:
    mesh = viewed_mesh(stored_mesh(asset), Path("made.triasset"))
    return build_model(mesh, *audit_arrays(mesh.vertices, mesh.faces))


SAMPLERS = pytest.mark.parametrize(
    "sampler",
    [
        Sampler(),
        Sampler("nearest", mipmaps=False, wrap_u="clamp", wrap_v="clamp", alpha_cutoff=0.5),
        Sampler("nearest", mipmaps=False, wrap_u="mirror", wrap_v="clamp"),
        Sampler("nearest", mipmaps=False, wrap_u="repeat", wrap_v="mirror"),
    ],
)


def same(seen: np.ndarray, asset: msb.Asset, model: ViewModel) -> bool:
    """Return whether an image agrees with the standard tier, except at smoothed edges."""
    eye = EYE * model.scale + model.center
    camera = msb.Camera.look_at(eye, model.center, up=(0, 1, 0), width=240, height=200, fov_y=FOV_Y)
    background = [value / 255 for value in BACKGROUND]
    drawn = np.rint(255 * msb.render(asset, camera, tier="standard", background=background).image)
    return bool((np.abs(seen.astype(int) - drawn).max(axis=2) <= 2).mean() > 0.97)


@SAMPLERS
def test_the_window_shows_what_the_standard_tier_draws(gl: None, sampler: Sampler) -> None:
    asset = textured(sampler, vertex_colors=np.full((6, 4), (200, 255, 90, 250), np.uint8))
    model = model_of(asset)
    with closing(TopologyViewer(model, size=(240, 200), off_screen=True)) as viewer:
        viewer.state.legend, viewer.state.message, viewer.state.visible = False, "", set()
        viewer.pose = Pose(EYE, np.zeros(3), np.array([0.0, 1.0, 0.0]))
        assert same(viewer.image(), asset, model)
        viewer.state.coloring = "grey"
        assert len(np.unique(viewer.image().reshape(-1, 3), axis=0)) < 200


@pytest.mark.slow
@SAMPLERS
def test_the_page_shows_what_the_standard_tier_draws(
    in_browser: Callable[..., Any], sampler: Sampler
) -> None:
    asset = textured(sampler, vertex_colors=np.full((6, 4), (200, 255, 90, 250), np.uint8))
    model = model_of(asset)
    state = replace(ViewState.first(model), visible=set())
    eye = EYE.tolist()
    script = f"""
      const ready = () => surface && !waiting && meta.skin.textures.every((item) => item.texture);
      while (!ready()) await new Promise(requestAnimationFrame);
      state.legend = false;
      Object.assign(camera, {{ direction: {eye}, up: [0, 1, 0], distance: Math.hypot(...{eye}) }});
      draw();
      const bytes = new Uint8Array(4 * canvas.width * canvas.height);
      gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
      return Array.from(bytes);
    """
    result = in_browser(page(model, state, "+y"), script, size=(240, 200))
    seen = np.array(result).reshape(200, 240, 4)[::-1, :, :3]
    assert same(seen, asset, model)


def test_faces_with_the_same_texture_are_contiguous_on_the_page() -> None:
    asset = textured(Sampler(wrap_v="mirror"))
    model = model_of(asset)
    _, meta, arrays = parts(model)
    order = [0, 2, 1, 3]
    assert (arrays["faces"].reshape(-1, 3) == model.faces[order]).all()
    uvs = asset.buffers["uv"][asset.buffers["indices"]]
    assert (arrays["uvs"].reshape(-1, 3, 2) == uvs[order]).all()
    assert "colors" not in arrays
    skin = meta["skin"]
    assert (skin["wrap_u"], skin["wrap_v"], skin["tinted"]) == ("repeat", "mirror", False)
    for number, texture in enumerate(skin["textures"]):
        assert texture["faces"] == 2
        image = np.array(Image.open(io.BytesIO(arrays[texture["name"]].tobytes())))
        assert (image == asset.buffers[f"texture.{number}"]).all()


def test_rounding_to_bytes_does_not_move_alpha_below_the_cutoff() -> None:
    tint = np.full((6, 4), (1, 1, 1, 0.7), np.float32)
    skin = model_of(textured(Sampler(alpha_cutoff=0.7), vertex_colors=tint)).skin
    assert skin.tint[0, 3] / 255 >= skin.cutoff


def test_a_mesh_with_invalid_textures_is_drawn_without_them() -> None:
    asset = textured(Sampler())
    uvs = asset.buffers["uv"].copy()
    uvs[2] = np.nan
    model = model_of(replace(asset, buffers={**asset.buffers, "uv": uvs}))
    assert (model.skin, model.colors) == (None, None)
    assert model.notes
