"""DiffSoup's lattices: values at nodes of every triangle, interpolated; see docs/reference.md."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_array


def node_count(level: int) -> int:
    """Return the number of a lattice's nodes, (2^level + 1)(2^level + 2) / 2."""
    side = 2**level
    return (side + 1) * (side + 2) // 2


class Interpolate(torch.autograd.Function):
    """Compute values at pairs (P, C) from lattices (F, S, C) and barycentric coordinates b0, b1 (P,).


    Values are linear between three nodes, as in `msb.methods.diffsoup.reference.interpolate`.
    """

    @staticmethod
    def forward(
        ctx: Any,
        values: torch.Tensor,
        b0: torch.Tensor,
        b1: torch.Tensor,
        faces: NDArray[np.int64],
        level: int,
    ) -> torch.Tensor:
        nodes, weights, flip = _nodes(b0.detach().numpy(), b1.detach().numpy(), level)
        index = faces[:, None] * values.shape[1] + nodes
        table = values.detach().reshape(-1, values.shape[2]).numpy()
        size = len(index), len(table)
        matrix = csr_array(
            (weights.reshape(-1), index.reshape(-1), np.arange(0, 3 * len(index) + 1, 3)), size
        )
        ctx.saved = matrix, index, flip, table, values.shape, 2**level
        return torch.from_numpy(matrix @ table)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        matrix, index, flip, table, shape, side = ctx.saved
        slope = grad.contiguous().numpy()
        values = torch.from_numpy(matrix.T @ slope).reshape(shape)
        if not ctx.needs_input_grad[1]:
            return values, None, None, None, None
        d0, d1, d2 = (np.einsum("pc,pc->p", slope, table[index[:, k]]) for k in range(3))
        for_b0 = side * np.where(flip, d2 - d1, d0 - d2)
        for_b1 = side * np.where(flip, d2 - d0, d1 - d2)
        return values, torch.from_numpy(for_b0), torch.from_numpy(for_b1), None, None


def _nodes(
    b0: NDArray[Any], b1: NDArray[Any], level: int
) -> tuple[NDArray[np.int64], NDArray[Any], NDArray[np.bool_]]:
    """Return three nodes and weights, (P, 3) each, and whether a point is in an upside-down triangle."""
    side = 2**level
    u, v = b0 * side, b1 * side
    x = np.clip(np.floor(u), 0, side - 1).astype(np.int64)
    y = np.clip(np.floor(v).astype(np.int64), 0, side - 1 - x)
    u, v = u - x.astype(u.dtype), v - y.astype(v.dtype)
    flip = u + v > 1
    w0, w1 = np.where(flip, 1 - v, u), np.where(flip, 1 - u, v)
    x2 = x + flip
    y2 = np.minimum(y + flip, side - x2)
    nodes = [(i + j) * (i + j + 1) // 2 + j for i, j in ((x + 1, y), (x, y + 1), (x2, y2))]
    return np.stack(nodes, axis=1), np.stack([w0, w1, 1 - w0 - w1], axis=1), flip


def lattice_nodes(level: int) -> NDArray[np.float64]:
    """Return the barycentric coordinates (S, 3) of a lattice's nodes."""
    side = 2**level
    sums = np.repeat(np.arange(side + 1), np.arange(1, side + 2))
    y = np.arange(len(sums)) - sums * (sums + 1) // 2
    return np.stack([sums - y, y, side - sums], axis=1) / side


def sampled(places: NDArray[Any], level: int) -> torch.Tensor:
    """Return the matrix (n, S) that interpolates a lattice at barycentric coordinates (n, 3)."""
    nodes, weights, _ = _nodes(places[:, 0], places[:, 1], level)
    matrix = np.zeros((len(places), node_count(level)), np.float32)
    np.add.at(matrix, (np.arange(len(places))[:, None], nodes), weights)
    return torch.from_numpy(matrix)


@cache
def refinement(coarse: int, fine: int) -> torch.Tensor:
    """Return the matrix (S_fine, S_coarse) that interpolates a coarse lattice at the nodes of a finer one."""
    return sampled(lattice_nodes(fine), coarse)
