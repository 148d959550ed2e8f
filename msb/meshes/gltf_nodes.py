"""Which meshes the scene of a glTF document shows, and where."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import shorten

if TYPE_CHECKING:
    from msb.meshes.gltf import Document

IDENTITY = np.eye(4)

MAX_NODES = 1 << 20
"""Most nodes of a scene. Real scenes have some thousand; a million take a few seconds."""


def placed_meshes(document: Document) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield number and world transform (4, 4) of each mesh the scene shows, in ascending order of nodes.

    The scene is the one the file names, else its first; without scenes all nodes are shown.
    """
    worlds = _world_transforms(document)
    for index in sorted(worlds):
        node, pointer = document.entry("nodes", index)
        if "mesh" in node:
            yield document.integer(node, "mesh", pointer), worlds[index]


def _world_transforms(document: Document) -> dict[int, NDArray[np.float64]]:
    """Return the world transform (4, 4) of every node reached from the scene."""
    roots, nodes = _roots(document)
    worlds: dict[int, NDArray[np.float64]] = {}
    waiting = [(roots, IDENTITY)]
    while waiting:
        siblings, parent = waiting.pop()
        for index in siblings:
            node, pointer = document.entry("nodes", index)
            if index in worlds:
                text = "the node is reached twice; nodes form trees, without cycles and with one parent each"
                raise document.error("MESH_FILE_INVALID", pointer, text)
            local = _local_transform(document, node, pointer)
            with np.errstate(over="ignore", invalid="ignore"):
                worlds[index] = parent if local is IDENTITY else parent @ local
            waiting.append((_node_numbers(document, node, "children", pointer), worlds[index]))
    if nodes is not None and len(worlds) < nodes:
        text = "some nodes are reached from no root; nodes form trees, without cycles"
        raise document.error("MESH_FILE_INVALID", "/nodes", text)
    return worlds


def _roots(document: Document) -> tuple[list[int], int | None]:
    """Return the root nodes, and how many nodes they must reach: None where a scene chose them."""
    count = len(document.array(document.root, "nodes", ""))
    if count > MAX_NODES:
        text = f"there are {count} nodes, more than {MAX_NODES}"
        raise document.error("MESH_FILE_TOO_LARGE", "/nodes", text)
    if document.array(document.root, "scenes", ""):
        number = document.integer(document.root, "scene", "", default=0)
        scene, pointer = document.entry("scenes", number)
        return _node_numbers(document, scene, "nodes", pointer), None
    entries = (document.entry("nodes", index) for index in range(count))
    children = {child for node in entries for child in _node_numbers(document, node[0], "children", node[1])}
    return [index for index in range(count) if index not in children], count


def _node_numbers(document: Document, owner: dict[str, Any], key: str, pointer: str) -> list[int]:
    """Return `owner[key]`, an array of node numbers."""
    numbers = document.array(owner, key, pointer)
    count = len(document.array(document.root, "nodes", ""))
    for number in numbers:
        if type(number) is not int or not 0 <= number < count:
            text = f"'{shorten(str(number))}' is not the number of one of the {count} nodes"
            raise document.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
    return numbers


def _local_transform(document: Document, node: dict[str, Any], pointer: str) -> NDArray[np.float64]:
    """Return the node's own transform (4, 4): its matrix, or translation times rotation times scale."""
    if "matrix" in node:
        return document.numbers(node, "matrix", pointer, tuple(IDENTITY.ravel())).reshape(4, 4).T
    if not node.keys() & {"translation", "rotation", "scale"}:
        return IDENTITY
    x, y, z, w = document.numbers(node, "rotation", pointer, (0, 0, 0, 1))
    with np.errstate(all="ignore"):
        s = 2 / (x * x + y * y + z * z + w * w)
        rotation = np.array(
            [
                [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
                [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
                [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
            ]
        )
        if not np.isfinite(rotation).all():
            text = "'rotation' is no rotation; a quaternion of length 1 is right"
            raise document.error("MESH_FILE_INVALID", f"{pointer}/rotation", text)
        transform = np.eye(4)
        transform[:3, :3] = rotation * document.numbers(node, "scale", pointer, (1, 1, 1))
    transform[:3, 3] = document.numbers(node, "translation", pointer, (0, 0, 0))
    return transform
