"""Draw the golden images of textured scenes: `python -m tests.engines.textures`.

Renderer `wgpu` draws them on Mesa's lavapipe, so they show its rasterizer, samplers and mip-map filter.
"""

import numpy as np

import msb
from tests.conftest import ROOT
from tests.render.standard_scenes import BACKGROUND
from tests.render.textured_scenes import CASES, golden_scene


def main() -> None:
    folder = ROOT / "tests/golden/textures"
    folder.mkdir(exist_ok=True)
    for case in CASES:
        asset, view = golden_scene(case)
        with msb.Renderer(asset, name="wgpu", device="cpu") as renderer:
            frame = renderer.render(view, BACKGROUND)
        assert frame.face_id is not None
        image, faces = np.rint(255 * frame.image).astype(np.uint8), frame.face_id.astype(np.int16)
        np.savez_compressed(folder / f"{case.replace(' ', '_')}.npz", image=image, face_id=faces)


if __name__ == "__main__":
    main()
