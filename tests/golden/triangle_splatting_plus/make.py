"""Make the golden views of Triangle Splatting+: `python -m tests.golden.triangle_splatting_plus.make`."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import msb
from msb.reference import render_reference
from tests.reference.golden import View, exported, golden_views

FILE = Path(__file__).parent / "nasty_topology_sh0" / "views.npz"


def scene() -> Iterator[tuple[View, msb.Asset]]:
    """Yield the views of MeshSplatting whose model is there in the layout of Triangle Splatting+, and it."""
    for view in golden_views("mesh_splatting"):
        folder = view.folder / "checkpoint_older_layout"
        if folder.exists() and view.camera.width == 160:
            yield view, exported(folder)


if __name__ == "__main__":
    FILE.parent.mkdir(exist_ok=True)
    arrays = {}
    for number, (view, model) in enumerate(scene()):
        frame = render_reference(model, view.camera, view.background, view.settings)
        for name in ("image", "face_id", "depth"):
            arrays[f"v{number}_{name}"] = getattr(frame, name)
    np.savez_compressed(FILE, **arrays)
