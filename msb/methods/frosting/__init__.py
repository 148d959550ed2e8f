"""Gaussian Frosting: Gaussians in a layer on a mesh. Renderers draw the textured mesh that Frosting
exports."""

from msb.methods.sugar import PHOTOGRAPHS
from msb.registry import extracted_mesh
from msb.scenes.datasets.rules import Rules

METHOD = extracted_mesh(
    "Frosting mesh",
    # The names follow Anttwo/Frosting at 08b1cb2: frosting_trainers/refine.py, in
    # output/refined_frosting_base_mesh/SCENE.
    ("frostingfine_*.obj",),
    Rules("Frosting", "Anttwo/Frosting: frosting_scene/cameras.py", photographs=PHOTOGRAPHS),
)
