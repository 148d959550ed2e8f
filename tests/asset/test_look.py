"""Colours and face selection of the standard tier are the same everywhere."""

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from msb.adapters.exporter import export
from msb.adapters.official import write_official
from msb.asset import Asset, Description, build_asset, write_asset
from msb.asset.look import drawn_colors, select_faces, stored_threshold, visible_faces
from msb.asset.settings import effective_settings
from msb.errors import AssetError
from msb.meshes import read_mesh
from msb.meshes.assets import mesh_from_asset
from msb.methods.two_dts.reference import straight_through
from msb.reference import arithmetic
from msb.reference.parameters import opacities
from msb.render.splat.model import make_model
from tests.conftest import ROOT
from tests.reference.soups import random_triangles, soup

WILD = np.array([[2, -1, 0.5], [1.5, 0.25, -0.25], [-3, 0, 1]], np.float32)
TAME = np.array([[1, 0, 0.5], [1, 0.25, 0], [0, 0, 1]], np.float32)


def wild(domain: str = "vertex") -> Asset:
    """Return a triangle with colours outside [0, 1]."""
    buffers = {"positions": np.eye(3, dtype=np.float32), "indices": np.array([[0, 1, 2]], np.uint32)}
    buffers["color"] = WILD[:1] if domain == "face" else WILD
    return build_asset(buffers, {"color": domain}, Description())


def test_an_asset_gives_its_arrays_in_the_types_of_other_libraries() -> None:
    buffers = {"positions": np.eye(3, dtype=np.float32), "indices": np.array([[0, 1, 2]], np.uint32)}
    plain = build_asset(buffers, {}, Description())
    assert (plain.vertices.dtype, plain.faces.dtype, plain.colors) == (np.float64, np.int64, None)
    assert np.array_equal(plain.vertices, np.eye(3))
    assert np.array_equal(plain.faces, [[0, 1, 2]])
    plain.vertices[:] = 7  # a copy
    assert np.array_equal(plain.buffers["positions"], np.eye(3))
    bytes_ = {**buffers, "color": np.array([[0, 51, 255, 255]] * 3, np.uint8)}
    colored = build_asset(bytes_, {"color": "vertex"}, Description())
    assert colored.colors is not None
    assert colored.colors.dtype == np.float32
    assert np.allclose(colored.colors, [[0, 0.2, 1, 1]] * 3)


@pytest.mark.parametrize("domain", ["vertex", "face", "corner"])
def test_clamped_colours_are_the_same_everywhere(tmp_path: Path, domain: str) -> None:
    asset, expected = wild(domain), TAME[:1] if domain == "face" else TAME
    assert np.array_equal(drawn_colors(asset).values, expected)
    assert asset.colors is not None
    assert np.array_equal(asset.colors, expected)
    mesh = mesh_from_asset(asset)
    colors = mesh.face_colors if mesh.vertex_colors is None else mesh.vertex_colors
    assert np.array_equal(colors, np.broadcast_to(expected, colors.shape))
    engine = pytest.importorskip("msb.engines.engine")
    assert np.array_equal(engine.engine_mesh(asset, {}).colors, np.broadcast_to(expected, (3, 3)))
    write_asset(asset, tmp_path / "a.triasset")
    viewed_mesh = pytest.importorskip("msb_viewers.viewed_mesh")
    viewed = viewed_mesh.read_viewed_mesh(tmp_path / "a.triasset").colors
    assert np.array_equal(viewed.values, viewed_mesh.color_bytes(expected))


def test_the_same_faces_are_shown_everywhere(tmp_path: Path) -> None:
    path = ROOT / "tests" / "tiny" / "models" / "pebble" / "two_dts"
    asset = export(path, settings={"ste_threshold": 0.5})
    opacity = np.linspace(-3, 3, asset.manifest.face_count, dtype=np.float32)
    opacity = opacity.reshape(asset.buffers["opacity"].shape)
    asset = replace(asset, buffers=MappingProxyType({**asset.buffers, "opacity": opacity}))
    selected = select_faces(asset, stored_threshold(asset))
    assert 0 < len(selected) < asset.manifest.face_count
    assert len(mesh_from_asset(asset).faces) == len(selected)
    write_official(asset, tmp_path / "a.ply")
    assert len(read_mesh(tmp_path / "a.ply").faces) in (len(selected), 2 * len(selected))
    engine = pytest.importorskip("msb.engines.engine")
    assert np.array_equal(engine.engine_mesh(asset, {}).numbers, selected)


@pytest.mark.parametrize("domain", ["vertex", "corner"])
def test_a_threshold_needs_opacity_of_faces(domain: str) -> None:
    asset = soup("two_dts", random_triangles(1, 2))
    buffers = {**asset.buffers, "opacity": np.zeros(6, np.float32)}
    domains = {name: spec.domain for name, spec in asset.manifest.buffers.items()} | {"opacity": domain}
    built = build_asset(buffers, domains, Description.of(asset.manifest))
    with pytest.raises(AssetError, match="TRIASSET_BUFFER"):
        select_faces(built, 0.75)


@pytest.mark.parametrize("place", [0.1, 0.3, 0.7, 0.9])
def test_every_tier_rounds_opacity_alike(place: float) -> None:
    logits = np.linspace(-4, 4, 4001, dtype=np.float32)
    stepped = arithmetic.sigmoid(logits)
    once = (1 / (1 + np.exp(-logits.astype(np.float64)))).astype(np.float32)
    differing = np.flatnonzero(stepped > once)
    face = differing[int(place * len(differing))]
    threshold = float(once[face])
    asset = soup("two_dts", random_triangles(1, len(logits)), opacity=logits)
    settings = effective_settings(asset.manifest, {"ste_threshold": threshold})
    standard = visible_faces(asset, threshold)
    dedicated = make_model(asset, settings).coverage[:, 0] > 0.5
    reference = straight_through(opacities(asset, len(logits), np.float32), threshold) > 0.5
    assert reference[face]
    assert np.array_equal(reference, standard)
    assert np.array_equal(reference, dedicated)
