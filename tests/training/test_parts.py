"""Parts of the trainer by themselves."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from data_stubs.training.lattice import Interpolate, lattice_nodes, refinement
from data_stubs.training.lattices import halved
from data_stubs.training.losses import Photograph, dssim
from data_stubs.training.mesh import split_edges
from data_stubs.training.pairs import Ranks
from msb import metrics


def test_dssim_is_one_minus_the_ssim_of_the_metrics() -> None:
    first, second = np.random.default_rng(0).random((2, 30, 41, 3))
    found = dssim(torch.from_numpy(first), Photograph(torch.from_numpy(second)))
    assert 1 - found.item() == pytest.approx(metrics.ssim(first, second, quantize=False), abs=1e-6)


def test_blurring_is_its_own_derivative() -> None:
    first = torch.rand((9, 12, 3), dtype=torch.float64, requires_grad=True)
    second = Photograph(torch.rand((9, 12, 3), dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda image: dssim(image, second), (first,))


def test_ranks_are_front_to_back_in_every_pixel() -> None:
    random = np.random.default_rng(1)
    pixel = random.integers(0, 40, 500).astype(np.int32)
    key = (1 + random.integers(0, 30, 500) / 10).astype(np.float32)
    for keys, wanted in ((None, np.arange(500)), (key, np.lexsort((np.arange(500), key)))):
        ranks = Ranks.of(pixel, keys)
        lists: dict[int, list[int]] = {}
        for part, _ in ranks.slices():
            for pair in ranks.pair[part].tolist():
                lists.setdefault(int(pixel[pair]), []).append(pair)
        for number, pairs in lists.items():
            assert pairs == [pair for pair in wanted.tolist() if pixel[pair] == number]


def test_a_refined_lattice_has_the_values_of_the_coarse_one() -> None:
    coarse = torch.rand((1, 6, 2), dtype=torch.float64)
    fine = refinement(1, 3).double() @ coarse
    inside = torch.from_numpy(np.random.default_rng(2).dirichlet((1, 1, 1), 20))
    number = np.zeros(20, np.int64)
    values = [
        Interpolate.apply(table, inside[:, 0], inside[:, 1], number, level)
        for table, level in ((coarse, 1), (fine, 3))
    ]
    assert torch.allclose(*values)
    assert (lattice_nodes(2).sum(axis=1) == 1).all()


def test_halves_show_what_the_whole_showed() -> None:
    corners = np.eye(3, dtype=np.float32)[None].repeat(3, 0)  # places are barycentric coordinates
    plane = torch.rand((3, 3, 8))
    for level in (0, 2):
        whole = refinement(0, level) @ plane
        places, lattices = halved(corners, whole, np.arange(3), level)
        inside = torch.from_numpy(np.random.default_rng(3).dirichlet((1, 1, 1), 6)).float()
        for half in range(6):
            where = inside @ places[half]
            one = np.full(6, half)
            found = Interpolate.apply(
                lattices, inside[:, 0].contiguous(), inside[:, 1].contiguous(), one, level
            )
            wanted = Interpolate.apply(
                whole, where[:, 0].contiguous(), where[:, 1].contiguous(), one // 2, level
            )
            assert torch.allclose(found, wanted, atol=1e-5)


def test_split_edges_leave_a_closed_mesh_closed() -> None:
    tetrahedron = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
    faces, count = tetrahedron, 4
    for seed in range(4):
        order = np.random.default_rng(seed).permutation(len(faces))
        faces, middles = split_edges(faces, np.arange(len(faces)) % 3, order, count)
        count += len(middles)
        assert len(middles) > 0
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], 2), 2).reshape(-1, 2)
        _, uses = np.unique(ends, axis=0, return_counts=True)
        assert (uses == 2).all()
        assert faces.max() == count - 1
