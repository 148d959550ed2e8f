"""SuGaR: Gaussians on a mesh; shown as that mesh with the texture that their renderings give."""

from msb.registry import extracted_mesh
from msb.scenes.datasets.rules import FAMILY, Photographs, Rules

PHOTOGRAPHS = {
    **{key: rule for key, rule in FAMILY.items() if key != "dtu"},
    # Sides above 1920 pixels are reduced to that; both sides are rounded where ours are cut off.
    "mipnerf360/outdoor": Photographs(resolution=1920),
    "mipnerf360/indoor": Photographs(resolution=1920),
}
METHOD = extracted_mesh(
    "SuGaR mesh",
    # Anttwo/SuGaR: sugar_extractors/refined_mesh.py, in output/refined_mesh/SCENE.
    ("sugarfine_*_postprocessed.obj", "sugarfine_*.obj"),
    Rules("SuGaR", "Anttwo/SuGaR: sugar_scene/cameras.py", photographs=PHOTOGRAPHS),
)
