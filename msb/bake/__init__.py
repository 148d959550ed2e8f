"""Convert a trained model into an opaque mesh whose texture or vertex colours match native renderings.

The modules are the stages of a bake. `views` chooses cameras, and `image_source` draws their images.
`candidate_kept`, `candidate_fitted` and `candidate_surface` make meshes. `vertex_colors` and `texture` fit
colours, and `pipeline` chooses a candidate. `lods` and `collision` make the levels of detail and the
collision shape. The module `quality` measures the result on held-out views. The modules `output_files` and
`folder` write the files. The function `run.bake` performs a whole bake.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.bake.report import Psnr, Report
    from msb.bake.run import Baked, bake

__all__ = ["Baked", "Psnr", "Report", "bake"]

make_lazy(
    __name__,
    {"Baked": "msb.bake.run", "Psnr": "msb.bake.report", "Report": "msb.bake.report", "bake": "msb.bake.run"},
)
