"""Textures by least squares: they show what they were taught, and leave alone what no picture shows."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.bake.lessons import Lessons
from msb.bake.painting import Painting
from msb.bake.soup import is_uncut_soup
from msb.bake.stencils import SMOOTHNESS, STEPS, Pyramid
from msb.bake.texture import FEW, _charts, textured
from msb.base.extras import is_installed
from msb.cl import Device
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from msb.metrics import psnr
from msb.render import Renderer
from msb.scenes import Camera
from tests.bake.soups import all_round, lessons_of, tiles
from tests.bake.teaching_twin import applied, asked_of, samples_of, solved

GREY = (0.5, 0.5, 0.5)


def camera(x: float, turn: float, distance: float, width: int = 96) -> Camera:
    """Return a camera that looks at the wall of `wall`."""
    c, s = np.cos(turn), np.sin(turn)
    pose = np.array([[c, 0, s, x], [0, 1, 0, 0], [-s, 0, c, distance], [0, 0, 0, 1.0]])
    return Camera(width, 72, float(width), float(width), width / 2, 36.0, pose)


CAMERAS = [camera(0.2, 0.0, 2.2), camera(-0.3, 0.5, 2.4), camera(0.1, -0.6, 2.6), camera(0.0, 0.2, 4.0)]


def wall(*, joined: bool = False) -> Mesh:
    """Return a grey wall of two faces, and a third face, blue and red, behind all cameras."""
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
    """Return the wall with soft shapes on it."""
    y, x = np.mgrid[0:64, 0:64] / 63
    image = np.stack([np.sin(9 * x) ** 2, (x * y), np.cos(7 * y - 3 * x) ** 2], axis=2)
    uvs = (wall().vertices[:, :2] / 2 + 0.5).astype(np.float32)
    pixels = np.rint(image * 255).astype(np.uint8)
    return replace(wall(), vertex_colors=None, corner_uvs=uvs, textures=(pixels,))


def lessons(cameras: list[Camera]) -> Lessons:
    renderer = Renderer(asset_from_mesh(painted()), "standard")
    return Lessons(cameras, GREY, lambda each: renderer.render(each, background=GREY).image)


def drawn(mesh: Mesh, seen: Camera) -> NDArray[np.float32]:
    with Renderer(asset_from_mesh(mesh), "standard") as renderer:
        return renderer.render(seen, background=GREY).image


def at_corners(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return places (F, 3, 3) and texture coordinates (F, 3, 2) of the corners of faces."""
    return mesh.vertices[mesh.faces].astype(float), mesh.corner_uvs.reshape(-1, 3, 2).astype(float)


def test_shows_what_it_was_taught() -> None:
    """Also from where no picture was taken; the same bytes each time; the watcher hears of each picture."""
    other = camera(-0.1, -0.2, 2.3)
    heard = []
    with lessons(CAMERAS) as taught:
        made = textured(wall(), taught, 128, watch=lambda *what: heard.append(what))
        again = textured(wall(), taught, 128)
    assert psnr(drawn(made, other), drawn(painted(), other)) > 40
    assert psnr(drawn(wall(), other), drawn(painted(), other)) < 15
    assert made.textures[0].shape == (128, 128, 3)
    assert made.vertex_colors is None
    assert made.sampler == Sampler("linear", mipmaps=True, wrap_u="clamp", wrap_v="clamp")
    assert np.array_equal(made.textures[0], again.textures[0])
    assert np.array_equal(made.corner_uvs, again.corner_uvs)
    few = len(CAMERAS[::FEW])
    assert heard == [("texture", done + 1, few + len(CAMERAS)) for done in range(few + len(CAMERAS))]


def test_faces_cut_apart_for_their_colours_have_no_chart_in_common() -> None:
    """Those of a mesh that was cut along all its edges: its colours jump there."""
    whole = wall(joined=True)
    painted = np.eye(3, dtype=np.float32)
    mesh = with_vertex_colors(replace(whole, vertex_colors=None, face_colors=painted))
    assert not is_uncut_soup(mesh.vertices, mesh.faces)
    with lessons(CAMERAS[:1]) as taught:
        made = textured(mesh, taught, 128)
    assert len(np.unique(_charts(made, made.corner_uvs))) == len(mesh.faces)


@pytest.mark.skipif(not is_installed("xatlas"), reason="xatlas is not installed")
def test_surface() -> None:
    """Where faces share vertices the colours of what no picture shows stay what they were."""
    other = camera(-0.1, -0.2, 2.3)
    with lessons(CAMERAS) as taught:
        made = textured(wall(joined=True), taught, 128)
    assert psnr(drawn(made, other), drawn(painted(), other)) > 38
    behind = Camera(
        64, 64, 64.0, 64.0, 20.0, 20.0, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 92], [0, 0, 0, 1]])
    )
    near = replace(behind, cx=32.0, cy=32.0)
    assert psnr(drawn(made, near), drawn(wall(), near)) > 35


@pytest.mark.skipif(not is_installed("xatlas"), reason="xatlas is not installed")
@pytest.mark.parametrize(("continues", "green"), [(True, 0), (False, 255)])
def test_what_closes_a_surface_goes_on_as_what_is_seen(continues: bool, green: int) -> None:
    """The wall goes on to the right beyond all pictures, where its colours have green in them."""
    x = np.repeat(np.arange(-12, 40) / 4, 2)
    y = np.tile([-1.0, 1.0], 52)
    faces = np.array([[k, k + 1 + k % 2, k + 2 - k % 2] for k in range(102)])
    colors = np.stack([0 * x, x > 0, 0 * x], axis=1).astype(np.float32)
    mesh = Mesh(np.stack([x, y, 0 * x], axis=1).astype(np.float32), faces, vertex_colors=colors)
    with lessons(CAMERAS[:1]) as taught:
        made = textured(mesh, taught, 128, continues=continues)
    seen = drawn(made, camera(-8.0, 0.0, 2.0))
    assert np.abs(seen[30:40, 40:56, 1] * 255 - green).max() < 30


def test_face_that_no_picture_shows_is_one_colour() -> None:
    """In a soup it has a texel, which has the mean of its colours."""
    with lessons(CAMERAS[:1]) as taught:
        made = textured(wall(), taught, 64)
    x, y = np.floor(made.corner_uvs[6] * 64).astype(int)
    assert np.array_equal(made.corner_uvs[6], made.corner_uvs[8])
    assert made.textures[0][y, x].tolist() == [170, 0, 85]


def test_samples_are_those_of_the_standard_tier() -> None:
    """Near and far, and askew: a little change of texels changes the picture as the samples say."""
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
        difference = (drawn(noisy, seen) - drawn(flat, seen)).reshape(-1, 3)
        with Renderer(asset_from_mesh(flat), "standard") as renderer:
            faces = renderer.render(seen).face_id
        pixel = np.flatnonzero(faces >= 0)
        row, texel, blend, share = samples_of(*at_corners(flat), sides, seen, faces)
        levels = [change / 255]
        while len(levels) < len(sides):
            half = len(levels[-1]) // 2
            levels.append(levels[-1].reshape(half, 2, half, 2, 3).mean(axis=(1, 3)))
        texels = np.concatenate([level.reshape(-1, 3) for level in levels])
        said = np.zeros((faces.size, 3))
        np.add.at(said, row, np.einsum("n,nk,nkc->nc", share, blend, texels[texel]))
        assert np.abs(said - difference)[pixel].max() < 0.004  # rounded to bytes at each level
        assert np.corrcoef(said[pixel].ravel(), difference[pixel].ravel())[0, 1] > 0.97


def test_equations_are_those_of_the_samples() -> None:
    """The stencils say the same as a matrix with a row for each sample, and so does the right side."""
    rng = np.random.default_rng(1)
    sides, seen = np.array([8, 4, 2]), camera(0.1, 0.4, 4.0)
    mesh = painted()
    with Renderer(asset_from_mesh(mesh), "standard") as renderer:
        faces = renderer.render(seen).face_id
    lacks = rng.normal(size=(faces.size, 3))
    corners, uvs = at_corners(mesh)
    samples = samples_of(corners, 1.4 * uvs - 0.2, sides, seen, faces)
    equations = asked_of(samples, lacks, int((sides**2).sum()))
    half = np.kron(np.eye(4), np.full((1, 2), 0.5))
    means = np.kron(half, half)
    fourth = np.kron(np.kron(np.eye(2), np.full((1, 2), 0.5)), np.kron(np.eye(2), np.full((1, 2), 0.5)))
    levels = np.concatenate([np.eye(64), means, fourth @ means])
    row, texel, blend, share = samples
    matrix = np.zeros((len(row), len(levels)))
    np.add.at(matrix, (np.arange(len(row))[:, None], texel), blend)
    matrix = matrix @ levels
    some = rng.normal(size=(64, 2))
    np.testing.assert_allclose(applied(equations, sides, some), (matrix.T * share) @ (matrix @ some))
    # Enough steps for 64 unknowns that are tied strongly: the solution of the equations.
    equations[:64, 0] += 30
    expected = np.linalg.solve((matrix.T * share) @ matrix + 30 * np.eye(64), matrix.T * share @ lacks[row])
    np.testing.assert_allclose(solved(equations, sides, 50), expected, rtol=1e-6)


@pytest.mark.parametrize("size", [64, 100, 34, 7, 2])
def test_equations_are_solved_as_numpy_solves_them(device: Device, size: int) -> None:
    """Nothing is asked of green; of some texels nothing is known; the same bits each time."""
    rng = np.random.default_rng(size)
    with closing(Pyramid(size, device)) as pyramid:
        equations = rng.uniform(-0.2, 0.2, (int(pyramid.starts[-1]), 8)).astype(np.float32)
        equations[:, 0] = rng.uniform(2, 4, len(equations))
        equations[:, 6] = 0
        for side, start in zip(pyramid.sides, pyramid.starts, strict=False):  # none beyond the border
            level = equations[start : start + side**2].reshape(side, side, 8)
            level[:, -1, [1, 3]] = level[:, 0, 4] = level[-1, :, 2:5] = 0
        equations[: size**2 // 4] = 0
        pyramid.equations.write(equations)
        found = pyramid.solved()
        pyramid.equations.write(equations)
        again = pyramid.solved()
        expected = solved(equations.astype(float), pyramid.sides, STEPS)
        assert set(pyramid.memory()) == {"bake equations"}
    np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=1e-4 * np.abs(expected).max())
    assert not found[..., 1].any()
    assert np.array_equal(found, again)


def test_what_is_asked_is_what_numpy_says(device: Device) -> None:
    """Of pictures of every size, near and askew; a picture that counts twice is there twice."""
    mesh = painted()
    views = [CAMERAS[0], camera(0.0, 1.2, 3.0), camera(0.0, 0.3, 9.0, 50)]
    with lessons(views) as taught, closing(Pyramid(64, device)) as pyramid:
        expected = np.zeros(pyramid.equations.shape)
        taught.weights = 1.0, 2.0, 1.0
        grey = replace(mesh, textures=(np.full((64, 64, 3), 99, np.uint8),))
        with closing(Painting(grey, taught, device)) as painting:
            asking = painting.ask(pyramid)
            assert next(asking) == 1
            assert "bake texture" in painting.memory()  # nobody else's to release
            assert [*asking] == [2, 3]
            for number, seen in enumerate(views):
                frame = painting.render(seen, GREY)
                samples = samples_of(*at_corners(mesh), pyramid.sides, seen, frame.face_id)
                lacks = (taught.image(number) - frame.image).reshape(-1, 3)
                expected += taught.weights[number] * asked_of(samples, lacks, len(expected))
        found = pyramid.equations.read()
    for some in np.s_[:, :5], np.s_[:, 5:]:
        np.testing.assert_allclose(found[some], expected[some], atol=2e-3 * np.abs(expected[some]).max())


def test_charts_do_not_run_into_each_other(device: Device) -> None:
    """Texels are tied to neighbours of their own chart alone."""
    chart = np.repeat([[0, 0, 1, 1]], 4, axis=0).astype(np.int32)
    with closing(Pyramid(4, device)) as pyramid:
        pyramid.tie(chart)
        equations = pyramid.equations.read()
        assert equations[5].tolist() == [3 * SMOOTHNESS, 0, -SMOOTHNESS, 0, 0, 0, 0, 0]
        equations[5, [0, 5]] += 1  # one texel is seen
        pyramid.equations.write(equations)
        change = pyramid.solved()[..., 0]
    assert change[:, :2].min() > 0.3
    assert np.abs(change[:, 2:]).max() == 0


def test_a_texel_that_no_picture_shows_stays_what_it_is(device: Device) -> None:
    """Alone in its chart; those beside it make up what a smaller level lacks."""
    chart = np.ones((4, 4), np.int32)
    chart[0, 0] = 0
    with closing(Pyramid(4, device)) as pyramid:
        pyramid.tie(chart)
        equations = pyramid.equations.read()
        assert equations[0].tolist() == [SMOOTHNESS, 0, 0, 0, 0, 0, 0, 0]
        equations[pyramid.starts[1], [0, 5]] += 100  # a pixel that shows the mean of all around it
        pyramid.equations.write(equations)
        change = pyramid.solved()[..., 0]
    assert change[:2, :2].mean() == pytest.approx(1, abs=0.02)
    assert change[0, 0] < 0.1 * change[1, 1]


@pytest.mark.slow
def test_of_one_chart_what_is_near_has_more_texels_than_what_is_far() -> None:
    if not is_installed("xatlas"):
        pytest.skip("extra trial is not installed")
    corners, colors = tiles(12)
    welded, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    floor = Mesh(30 * welded, faces.reshape(-1, 3))
    views = all_round(4, (2, 3))
    with lessons_of(30 * corners, colors, views) as lessons:
        made = textured(floor, lessons, 64)
    sides = np.diff(made.corner_uvs.reshape(-1, 3, 2), axis=1)
    texels = np.abs(np.linalg.det(sides.astype(np.float64)))
    away = np.linalg.norm(floor.vertices[floor.faces].mean(axis=1), axis=1)
    assert np.median(texels[away < 8]) > 5 * np.median(texels[away > 25])
