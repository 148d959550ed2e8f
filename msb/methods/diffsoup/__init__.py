"""DiffSoup: triangles with binary opacity and a lattice of features, which a small network decodes to
colours."""

from pathlib import Path

from msb.errors import AssetError
from msb.registry import AWARE, Method, Native, PaperNote, Retained, Setting
from msb.scenes.colors import BLACK, WHITE
from msb.scenes.datasets.catalog import CUSTOM
from msb.scenes.datasets.rules import Photographs, Rules

# Features per lattice sample, in addition to its opacity.
FEATURES = 7
# Highest level of a lattice. Official trainings end at lattice level 5. Level 8 has 33,153 samples per
# triangle.
MAX_LEVEL = 8
# The shape of each decoder layer's weight matrix, [out, in].
LAYERS = {"mlp.0": (16, 16), "mlp.2": (16, 16), "mlp.4": (3, 16)}


def samples(level: int) -> int:
    """Return the number of samples of a lattice: (2^L + 1)(2^L + 2) / 2 for level L."""
    return ((1 << level) + 1) * ((1 << level) + 2) // 2


def check_level(level: object, file: Path | None) -> int:
    """Return the lattice level of the manifest in `file`; raise TRIASSET_FIELD if it is invalid."""
    if type(level) is not int or not 0 <= level <= MAX_LEVEL:
        text = f"appearance.level is {level!r:.40}; it must be an integer from 0 to {MAX_LEVEL}"
        raise AssetError("TRIASSET_FIELD", text, file=file, pointer="/appearance/level")
    return level


METHOD = Method(
    title="DiffSoup",
    paper_name="diffsoup",
    paper_notes=(
        PaperNote(
            "the paper reports two results of DiffSoup on Tanks and Temples: 17.45 / 0.645 / 0.389 in its "
            "summary, 18.90 / 0.685 / 0.352 in its reproducibility table",
            ("psnr", "ssim", "lpips"),
            "tanksandtemples",
        ),
    ),
    native=Native(binary_opacity=True, neural_decoder=True),
    retained={"dedicated": Retained("Method-aware", "MLP", notes={"depth_sort": "depth test"}, **AWARE)},
    unsupported={
        "standard": "the colours come from a view-dependent decoder, so static colours do not exist"
    },
    settings={
        "layout": Setting("colmap", "choice", choices=("colmap", "synthetic")),
        "z_near": Setting(0.5, "float", positive=True),
        "z_far": Setting(100.0, "float", positive=True),
    },
    passes={"reference": ("z_buffer", "decode"), "dedicated": ("z_buffer", "decode")},
    files=("final_params.pt",),
    bundle=("mesh.ply", "lut0.png", "lut1.png", "mlp_weights.json"),
    rules=Rules(
        "DiffSoup",
        "kenji-tojo/diffsoup: examples/01_mip360.py, 02_synthetic.py",
        convention="full_K",
        first_lens=True,
        order="name",
        quantized=False,
        photographs={
            "mipnerf360": Photographs("images_4"),
            "nerf_synthetic": Photographs(".", compositing="before_resize"),
            CUSTOM: Photographs("images_4"),
        },
        backgrounds={"": BLACK, "nerf_synthetic": WHITE},
    ),
)
