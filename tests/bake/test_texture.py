"""Textures by least squares match their target images, and unseen texels keep their colours."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.bake.images import ViewImages
from msb.bake.soup import is_uncut_soup
from msb.bake.texture import FIRST_PASS_STEP, fit_texture, label_charts
from msb.bake.texture_equations import SMOOTHNESS, STEPS, TextureEquations
from msb.bake.texture_renderer import TextureRenderer
from msb.base.extras import is_installed
from msb.cl import Device
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from msb.metrics import psnr
from msb.render import Renderer
from msb.scenes import Camera
from tests.bake.soups import all_round, images_of, tiles
from tests.bake.sums_twin import apply_equations, equations_of, samples_of, solve_equations

GREY = (0.5, 0.5, 0.5)


def camera(x: float, turn: float, distance: float, width: int = 96) -> Camera:
    """Return a camera that looks at the wall."""
    c, s = np.cos(turn), np.sin(turn)
    pose = np.array([[c, 0, s, x], [0, 1, 0, 0], [-s, 0, c, distance], [0, 0, 0, 1.0]])
    return Camera(width, 72, float(width), float(width), width / 2, 36.0, pose)


CAMERAS = [camera(0.2, 0.0, 2.2), camera(-0.3, 0.5, 2.4), camera(0.1, -0.6, 2.6), camera(0.0, 0.2, 4.0)]


def wall(*, joined: bool = False) -> Mesh:
    """Return a grey wall of two faces. A blue face and a red one lie behind all cameras."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    behind = np.array([[0, 0, -90], [1, 0, -90], [0, 1, -90]], np.float32)
    faces = np.array([[0, 1, 2], [2, 3, 0], [4, 5, 6]])
    vertices = np.concatenate([corners, behind])
    colors = np.full((7, 3), 0.5, np.float32)
    colors[4:] = (0, 0, 1), (1, 0, 0), (1, 0, 0)
    if not joined:
        vertices, colors, faces = vertices[faces].reshape(-1, 3), colors[faces].reshape(-1, 3), faces
        faces = np.arange(9).reshape(3, 3)
    return Mesh(vertices, faces, vertex_colors=colors)


def painted() -> Mesh:
    """Return the wall with a smooth pattern as its texture."""
    y, x = np.mgrid[0:64, 0:64] / 63
    image = np.stack([np.sin(9 * x) ** 2, (x * y), np.cos(7 * y - 3 * x) ** 2], axis=2)
    uvs = (wall().vertices[:, :2] / 2 + 0.5).astype(np.float32)
    pixels = np.rint(image * 255).astype(np.uint8)
    return replace(wall(), vertex_colors=None, corner_uvs=uvs, textures=(pixels,))


def target_images(cameras: list[Camera]) -> ViewImages:
    renderer = Renderer(asset_from_mesh(painted()), "standard")
    return ViewImages(cameras, GREY, lambda camera: renderer.render(camera, background=GREY).image)


def draw(mesh: Mesh, view: Camera) -> NDArray[np.float32]:
    with Renderer(asset_from_mesh(mesh), "standard") as renderer:
        return renderer.render(view, background=GREY).image


def at_corners(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return places (F, 3, 3) and texture coordinates (F, 3, 2) of the corners."""
    return mesh.vertices[mesh.faces].astype(float), mesh.corner_uvs.reshape(-1, 3, 2).astype(float)


def test_a_texture_matches_new_views_and_is_reproducible() -> None:
    other = camera(-0.1, -0.2, 2.3)
    calls = []
    with target_images(CAMERAS) as images:
        baked = fit_texture(wall(), images, 128, progress=lambda *call: calls.append(call))
        again = fit_texture(wall(), images, 128)
    assert psnr(draw(baked, other), draw(painted(), other)) > 40
    assert psnr(draw(wall(), other), draw(painted(), other)) < 15
    assert baked.textures[0].shape == (128, 128, 3)
    assert baked.vertex_colors is None
    assert baked.sampler == Sampler("linear", mipmaps=True, wrap_u="clamp", wrap_v="clamp")
    assert np.array_equal(baked.textures[0], again.textures[0])
    assert np.array_equal(baked.corner_uvs, again.corner_uvs)
    few = len(CAMERAS[::FIRST_PASS_STEP])
    assert calls == [("texture", done + 1, few + len(CAMERAS)) for done in range(few + len(CAMERAS))]


def test_cut_faces_share_no_chart() -> None:
    """The colours of a mesh that was cut along all its edges differ on the two sides of each cut."""
    whole = wall(joined=True)
    colors = np.eye(3, dtype=np.float32)
    mesh = with_vertex_colors(replace(whole, vertex_colors=None, face_colors=colors))
    assert not is_uncut_soup(mesh.vertices, mesh.faces)
    with target_images(CAMERAS[:1]) as images:
        baked = fit_texture(mesh, images, 128)
    assert len(np.unique(label_charts(baked, baked.corner_uvs))) == len(mesh.faces)


@pytest.mark.skipif(not is_installed("xatlas"), reason="xatlas is not installed")
def test_a_connected_mesh_keeps_the_colours_of_unseen_parts() -> None:
    other = camera(-0.1, -0.2, 2.3)
    with target_images(CAMERAS) as images:
        baked = fit_texture(wall(joined=True), images, 128)
    assert psnr(draw(baked, other), draw(painted(), other)) > 38
    behind = Camera(
        64, 64, 64.0, 64.0, 20.0, 20.0, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 92], [0, 0, 0, 1]])
    )
    near = replace(behind, cx=32.0, cy=32.0)
    assert psnr(draw(baked, near), draw(wall(), near)) > 35


@pytest.mark.skipif(not is_installed("xatlas"), reason="xatlas is not installed")
@pytest.mark.parametrize(("extends", "green"), [(True, 0), (False, 255)])
def test_unseen_faces_continue_the_colours_around_them_on_request(extends: bool, green: int) -> None:
    """The wall continues to the right of all images; its vertex colours contain green there."""
    x = np.repeat(np.arange(-12, 40) / 4, 2)
    y = np.tile([-1.0, 1.0], 52)
    faces = np.array([[k, k + 1 + k % 2, k + 2 - k % 2] for k in range(102)])
    colors = np.stack([0 * x, x > 0, 0 * x], axis=1).astype(np.float32)
    mesh = Mesh(np.stack([x, y, 0 * x], axis=1).astype(np.float32), faces, vertex_colors=colors)
    with target_images(CAMERAS[:1]) as images:
        baked = fit_texture(mesh, images, 128, extends_colors=extends)
    seen = draw(baked, camera(-8.0, 0.0, 2.0))
    assert np.abs(seen[30:40, 40:56, 1] * 255 - green).max() < 30


def test_an_unseen_face_of_a_soup_is_a_texel_of_its_average_colour() -> None:
    with target_images(CAMERAS[:1]) as images:
        baked = fit_texture(wall(), images, 64)
    x, y = np.floor(baked.corner_uvs[6] * 64).astype(int)
    assert np.array_equal(baked.corner_uvs[6], baked.corner_uvs[8])
    assert baked.textures[0][y, x].tolist() == [170, 0, 85]


def test_samples_predict_the_change_of_the_image() -> None:
    """Compare the samples with the effect of small changes of the texels in near, far and oblique views."""
    size = 64
    rng = np.random.default_rng(5)
    change = rng.integers(-6, 7, (size, size, 3))
    grey = np.full((size, size, 3), 128, np.uint8)
    uvs = (wall().vertices[:, :2] / 2 + 0.5).astype(np.float32)
    sampler = Sampler("linear", mipmaps=True, wrap_u="clamp", wrap_v="clamp")
    flat = replace(wall(), vertex_colors=None, corner_uvs=uvs, textures=(grey,), sampler=sampler)
    noisy = replace(flat, textures=((grey + change).astype(np.uint8),))
    for seen in (CAMERAS[0], camera(0.0, 1.2, 3.0), camera(0.0, 0.3, 6.0)):
        sides = np.array([64, 32, 16, 8, 4, 2])
        difference = (draw(noisy, seen) - draw(flat, seen)).reshape(-1, 3)
        with Renderer(asset_from_mesh(flat), "standard") as renderer:
            faces = renderer.render(seen).face_id
        pixel = np.flatnonzero(faces >= 0)
        row, texel, blend, share = samples_of(*at_corners(flat), sides, seen, faces)
        levels = [change / 255]
        while len(levels) < len(sides):
            half = len(levels[-1]) // 2
            levels.append(levels[-1].reshape(half, 2, half, 2, 3).mean(axis=(1, 3)))
        texels = np.concatenate([level.reshape(-1, 3) for level in levels])
        predicted = np.zeros((faces.size, 3))
        np.add.at(predicted, row, np.einsum("n,nk,nkc->nc", share, blend, texels[texel]))
        assert np.abs(predicted - difference)[pixel].max() < 0.004  # each level is rounded to bytes
        assert np.corrcoef(predicted[pixel].ravel(), difference[pixel].ravel())[0, 1] > 0.97


def test_stencils_equal_the_normal_equations_of_the_samples() -> None:
    """Compare the stencils with a dense matrix that has a row for each sample."""
    rng = np.random.default_rng(1)
    sides, seen = np.array([8, 4, 2]), camera(0.1, 0.4, 4.0)
    mesh = painted()
    with Renderer(asset_from_mesh(mesh), "standard") as renderer:
        faces = renderer.render(seen).face_id
    differences = rng.normal(size=(faces.size, 3))
    corners, uvs = at_corners(mesh)
    samples = samples_of(corners, 1.4 * uvs - 0.2, sides, seen, faces)
    equations = equations_of(samples, differences, int((sides**2).sum()))
    half = np.kron(np.eye(4), np.full((1, 2), 0.5))
    means = np.kron(half, half)
    fourth = np.kron(np.kron(np.eye(2), np.full((1, 2), 0.5)), np.kron(np.eye(2), np.full((1, 2), 0.5)))
    levels = np.concatenate([np.eye(64), means, fourth @ means])
    row, texel, blend, share = samples
    matrix = np.zeros((len(row), len(levels)))
    np.add.at(matrix, (np.arange(len(row))[:, None], texel), blend)
    matrix = matrix @ levels
    some = rng.normal(size=(64, 2))
    np.testing.assert_allclose(apply_equations(equations, sides, some), (matrix.T * share) @ (matrix @ some))
    # 50 steps solve the equations of 64 strongly coupled unknowns.
    equations[:64, 0] += 30
    expected = np.linalg.solve(
        (matrix.T * share) @ matrix + 30 * np.eye(64), matrix.T * share @ differences[row]
    )
    np.testing.assert_allclose(solve_equations(equations, sides, 50), expected, rtol=1e-6)


@pytest.mark.parametrize("size", [64, 100, 34, 7, 2])
def test_solutions_agree_with_numpy(device: Device, size: int) -> None:
    """The right sides of green are 0, and some texels have no equation. Results are reproducible."""
    rng = np.random.default_rng(size)
    with closing(TextureEquations(size, device)) as system:
        equations = rng.uniform(-0.2, 0.2, (int(system.starts[-1]), 8)).astype(np.float32)
        equations[:, 0] = rng.uniform(2, 4, len(equations))
        equations[:, 6] = 0
        for side, start in zip(system.sides, system.starts, strict=False):  # no coupling across the border
            level = equations[start : start + side**2].reshape(side, side, 8)
            level[:, -1, [1, 3]] = level[:, 0, 4] = level[-1, :, 2:5] = 0
        equations[: size**2 // 4] = 0
        system.stencils.write(equations)
        solution = system.solve()
        system.stencils.write(equations)
        again = system.solve()
        expected = solve_equations(equations.astype(float), system.sides, STEPS)
        assert set(system.memory()) == {"bake equations"}
    np.testing.assert_allclose(solution.reshape(-1, 3), expected, atol=1e-4 * np.abs(expected).max())
    assert not solution[..., 1].any()
    assert np.array_equal(solution, again)


def test_sums_of_stencils_agree_with_numpy(device: Device) -> None:
    """The views are near, far and oblique, and have several sizes and weights."""
    mesh = painted()
    views = [CAMERAS[0], camera(0.0, 1.2, 3.0), camera(0.0, 0.3, 9.0, 50)]
    with target_images(views) as images, closing(TextureEquations(64, device)) as system:
        expected = np.zeros(system.stencils.shape)
        images.weights = 1.0, 2.0, 1.0
        grey = replace(mesh, textures=(np.full((64, 64, 3), 99, np.uint8),))
        with closing(TextureRenderer(grey, images, device)) as renderer:
            progress = renderer.add_equations(system)
            assert next(progress) == 1
            assert "bake texture" in renderer.memory()  # its own buffers
            assert [*progress] == [2, 3]
            for number, seen in enumerate(views):
                frame = renderer.render(seen, GREY)
                samples = samples_of(*at_corners(mesh), system.sides, seen, frame.face_id)
                differences = (images.image(number) - frame.image).reshape(-1, 3)
                expected += images.weights[number] * equations_of(samples, differences, len(expected))
        stencils = system.stencils.read()
    for some in np.s_[:, :5], np.s_[:, 5:]:
        np.testing.assert_allclose(stencils[some], expected[some], atol=2e-3 * np.abs(expected[some]).max())


def test_texels_are_coupled_within_their_chart_only(device: Device) -> None:
    chart = np.repeat([[0, 0, 1, 1]], 4, axis=0).astype(np.int32)
    with closing(TextureEquations(4, device)) as system:
        system.add_smoothness(chart)
        equations = system.stencils.read()
        assert equations[5].tolist() == [3 * SMOOTHNESS, 0, -SMOOTHNESS, 0, 0, 0, 0, 0]
        equations[5, [0, 5]] += 1  # one texel is seen
        system.stencils.write(equations)
        change = system.solve()[..., 0]
    assert change[:, :2].min() > 0.3
    assert np.abs(change[:, 2:]).max() == 0


def test_an_unseen_texel_that_is_alone_in_its_chart_stays(device: Device) -> None:
    """A pixel of a smaller level differs from its target. The other texels below it change instead."""
    chart = np.ones((4, 4), np.int32)
    chart[0, 0] = 0
    with closing(TextureEquations(4, device)) as system:
        system.add_smoothness(chart)
        equations = system.stencils.read()
        assert equations[0].tolist() == [SMOOTHNESS, 0, 0, 0, 0, 0, 0, 0]
        equations[system.starts[1], [0, 5]] += 100  # a pixel of the smaller level
        system.stencils.write(equations)
        change = system.solve()[..., 0]
    assert change[:2, :2].mean() == pytest.approx(1, abs=0.02)
    assert change[0, 0] < 0.1 * change[1, 1]


@pytest.mark.slow
def test_near_parts_of_a_chart_have_more_texels_than_far_parts() -> None:
    if not is_installed("xatlas"):
        pytest.skip("extra trial is not installed")
    corners, colors = tiles(12)
    welded, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    floor = Mesh(30 * welded, faces.reshape(-1, 3))
    views = all_round(4, (2, 3))
    with images_of(30 * corners, colors, views) as images:
        baked = fit_texture(floor, images, 64)
    sides = np.diff(baked.corner_uvs.reshape(-1, 3, 2), axis=1)
    texels = np.abs(np.linalg.det(sides.astype(np.float64)))
    distance = np.linalg.norm(floor.vertices[floor.faces].mean(axis=1), axis=1)
    assert np.median(texels[distance < 8]) > 5 * np.median(texels[distance > 25])
