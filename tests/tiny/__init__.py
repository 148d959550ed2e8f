"""Tiny scenes, a model of each method for them, and their benchmark protocol, for tests."""

from pathlib import Path

import numpy as np

from msb.meshes import Mesh, write_mesh

TINY = Path(__file__).parent
SCENES = TINY / "scenes"
MODELS = TINY / "models"


def link_demo(folder: Path) -> None:
    """Create `folder`/data_stubs: the demo data with tiny models and scenes instead of the shipped ones.

    Examples run faster with them. Models of the demo data have ten times as many faces, and its scenes have
    twice as many views.
    """
    tiny = {"models": MODELS, "scenes": SCENES}
    place = folder / "data_stubs"
    place.mkdir()
    for path in (TINY.parents[1] / "data_stubs").iterdir():
        if path.suffix == ".toml":  # its paths are relative to the file
            # Tiny models have no records of their training and their renderer.
            lines = path.read_text().splitlines(keepends=True)
            kept = [line for line in lines if not line.startswith(("training = ", "non_engine_timing = "))]
            (place / path.name).write_text("".join(kept))
        elif path.suffix != ".py" and path.name != "__pycache__":
            (place / path.name).symlink_to(tiny.get(path.name, path))


def write_chair(folder: Path) -> None:
    """Write chair.glb and scan.ply, the finished meshes of the examples: a ball of 21,840 faces."""
    rows, columns = 106, 104
    turns = 2 * np.pi * np.arange(columns) / columns
    polar, around = np.meshgrid(np.linspace(0.01, np.pi - 0.01, rows), turns)
    points = [np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)]
    # Corners of the quads between neighbouring columns, and the two triangles of each quad.
    index = np.arange(rows * columns).reshape(columns, rows)
    after = np.roll(index, -1, axis=0)
    quads = np.stack([index[:, :-1], index[:, 1:], after[:, 1:], after[:, :-1]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 2, 1]], quads[:, [0, 3, 2]]])
    for name in ("chair.glb", "scan.ply"):
        with (folder / name).open("wb") as file:
            write_mesh(Mesh(np.stack(points, axis=-1).reshape(-1, 3), faces), file, suffix=name[-4:])
