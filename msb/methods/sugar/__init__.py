"""SuGaR: Gaussians on a mesh. SuGaR's mesh is drawn with a texture baked from renderings of the Gaussians."""

from msb.registry import extracted_mesh
from msb.scenes.datasets.rules import FAMILY, Photographs, Rules

PHOTOGRAPHS = {
    **{key: rule for key, rule in FAMILY.items() if key != "dtu"},
    # Image sides above 1920 pixels are reduced to 1920. The official code rounds both sides of the image.
    # Ours truncates them.
    "mipnerf360/outdoor": Photographs(resolution=1920),
    "mipnerf360/indoor": Photographs(resolution=1920),
}
METHOD = extracted_mesh(
    "SuGaR mesh",
    # The names follow Anttwo/SuGaR: sugar_extractors/refined_mesh.py, in output/refined_mesh/SCENE.
    ("sugarfine_*_postprocessed.obj", "sugarfine_*.obj"),
    Rules("SuGaR", "Anttwo/SuGaR: sugar_scene/cameras.py", photographs=PHOTOGRAPHS),
)
