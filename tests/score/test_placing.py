"""Similarities and features: known answers without any photograph."""

import numpy as np
import pytest

from msb.scenes import Camera
from msb.score.features import detect_features, match_features, match_nearby
from msb.score.placing import (
    Matches,
    count_agreeing,
    guess_similarity,
    measure_errors,
    project,
    refine_similarity,
    solve_camera,
)
from msb.score.pose import Pose, PoseNotFoundError, normalise, spread_numbers

pytest.importorskip("cv2")


def make_matches(wrong: float = 0.0) -> tuple[np.ndarray, list[Matches]]:
    """Return a similarity and matches of six cameras; a share of them is wrong."""
    random = np.random.default_rng(0)
    matrix = np.eye(4)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    matrix[:3, :3] = 0.3 * turn * np.sign(np.linalg.det(turn))
    matrix[:3, 3] = (4, 5, 6)
    points = random.uniform(-1, 1, (200, 3))
    matches = []
    for k in range(6):
        eye = np.array([4, 5, 6]) + 2 * np.array([np.cos(k), np.sin(k), 0.4])
        camera = Camera.look_at(eye, (4, 5, 6), up=(0, 0, 1), width=400, height=300, fov_y=0.9)
        pixels = project(matrix, camera, points) + random.normal(0, 0.3, (200, 2))
        bad = random.random(200) < wrong
        pixels[bad] = random.uniform(0, 300, (int(bad.sum()), 2))
        matches.append(Matches(camera, points, pixels))
    return matrix, matches


def test_one_solved_camera_and_the_votes_of_others_give_the_similarity() -> None:
    matrix, matches = make_matches(wrong=0.6)
    solved = solve_camera(matches[0])
    assert solved is not None
    guess = guess_similarity(solved, matches[0], matches)
    assert count_agreeing(guess, matches) > 0.9 * count_agreeing(matrix, matches)
    refined, covariance = refine_similarity(guess, matches, 8.0)
    errors = np.concatenate(
        measure_errors(
            refined, [Matches(m.camera, m.points, project(matrix, m.camera, m.points)) for m in matches]
        )
    )
    assert errors.max() < 0.15
    # The true similarity is within five standard deviations of the scale.
    scale = np.cbrt(np.linalg.det(refined[:3, :3]))
    assert abs(np.log(scale / 0.3)) < 5 * np.sqrt(covariance[3, 3])


def test_too_few_matches_solve_no_camera() -> None:
    _, matches = make_matches()
    few = Matches(matches[0].camera, matches[0].points[:8], matches[0].pixels[:8])
    assert solve_camera(few) is None
    noise = Matches(few.camera, matches[0].points, np.random.default_rng(1).uniform(0, 300, (200, 2)))
    assert solve_camera(noise) is None


def test_features_of_a_mirror_image() -> None:
    random = np.random.default_rng(2)
    image = np.kron(random.random((30, 40, 3)), np.ones((8, 8, 1)))
    here, there = detect_features(image, 300), detect_features(image[:, ::-1], 300)
    pairs = match_features(here.mirrored(), there)
    assert len(pairs) > 0.7 * len(here)
    moved = here.pixels[pairs[:, 0]] * (-1, 1) + (image.shape[1], 0) - there.pixels[pairs[:, 1]]
    assert np.median(np.abs(moved)) < 0.5
    assert len(match_features(here, there)) < 0.5 * len(pairs)


def test_nearby_matches_are_mutual_and_within_the_radius() -> None:
    random = np.random.default_rng(3)
    image = np.kron(random.random((30, 40, 3)), np.ones((8, 8, 1)))
    features = detect_features(image, 300)
    pairs = match_nearby(features, features, 4.0)
    assert (pairs[:, 0] == pairs[:, 1]).mean() > 0.9
    shifted = type(features)(features.pixels + np.array([6, 0]), features.descriptors)
    distances = (
        features.pixels[(pairs := match_nearby(features, shifted, 4.0))[:, 0]] - shifted.pixels[pairs[:, 1]]
    )
    assert not len(pairs) or np.linalg.norm(distances, axis=1).max() <= 4
    empty = features.select(slice(0))
    assert not len(match_nearby(empty, features, 4.0))
    assert not len(match_features(empty, features))


def test_a_mesh_is_normalised_without_its_floaters() -> None:
    random = np.random.default_rng(4)
    vertices = np.concatenate([random.normal((5, 6, 7), 1e-6, (99, 3)), [(1e9, 0, 0)], [(np.nan, 0, 0)]])
    matrix = normalise(vertices, np.arange(99).reshape(-1, 3))
    moved = vertices[:99] @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.abs(np.median(moved, axis=0)).max() < 0.01
    assert np.isclose(
        np.quantile(np.linalg.norm(moved - np.median(moved, axis=0), axis=1), 0.9), 1, atol=0.01
    )
    with pytest.raises(PoseNotFoundError):
        normalise(np.zeros((3, 3)), np.array([[0, 1, 2]]))


def test_a_pose_knows_its_scale_and_handedness() -> None:
    pose = Pose("file", np.diag([-2.0, 2, 2, 1]))
    assert pose.scale == pytest.approx(2)
    assert (pose.mirrored, pose.to_dict()["mirrored"]) == (True, True)
    assert spread_numbers(10, 4) == [0, 2, 5, 7]
    assert spread_numbers(3, 4) == [0, 1, 2]
