"""The classes of the plain data that a method declares, and the words they use.

A method's package holds one `Method`, called ``METHOD``, in its ``__init__.py``. The registry
`msb.registry` collects them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from msb.scenes.datasets.rules import Rules

Tier = Literal["reference", "dedicated", "standard"]
TIERS: tuple[Tier, ...] = ("reference", "dedicated", "standard")

Order = Literal["tile", "global", "none"]
ORDERS: tuple[Order, ...] = ("tile", "global", "none")
Sampling = Literal["official", "engine"]
SAMPLINGS: tuple[Sampling, ...] = ("official", "engine")
"""The ways to order and sample primitives on the tiers that show a method's own look; see
docs/dedicated.md."""

SettingValue = bool | int | float | str | None
SettingSource = Literal["checkpoint", "config", "flag", "default"]
SETTING_SOURCES: tuple[str, ...] = ("checkpoint", "config", "flag", "default")

PASSES: dict[str, str] = {
    "opaque_unlit": "opaque, z-buffered, two-sided, unlit vertex colours; any engine has it",
    "bake_dc": "clamp(C0 * f_dc + 0.5) turned into vertex colours before drawing",
    "project_cull": "per-primitive projection, culling and appearance",
    "tile_sort": "assignment to tiles and stable depth sort within each tile",
    "blend_front_to_back": "front-to-back compositing with the method's coverage and stop rule",
    "z_buffer": "nearest face per pixel with the method's opacity test",
    "decode": "neural decoder of the lattice features seen by each pixel",
    "downsample": "box filter from the supersampled raster to the image",
    "opaque_unlit_texture": "as opaque_unlit, with textures: filtered in linear light, times the colours",
}
"""Name that a manifest's `required_passes` may use -> what the pass asks of a renderer."""


@dataclass(frozen=True)
class Setting:
    """A value that official code takes from a config or flag rather than from the checkpoint.

    Values are activated ones (`sigma` 1e-4, not its logarithm).
    """

    default: SettingValue
    kind: Literal["bool", "int", "float", "choice"]
    choices: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    positive: bool = False
    """Whether the value must be greater than zero; 0 is then refused, too."""
    optional: bool = False
    """Whether the value may also be None, which switches the setting off."""

    def problem(self, value: object) -> str | None:
        """Return what is wrong with `value`, or None if the setting can take it."""
        if value is None and self.optional:
            return None
        if self.kind == "choice":
            return None if value in self.choices else f"must be one of {', '.join(self.choices)}"
        if self.kind == "bool":
            return None if isinstance(value, bool) else "must be true or false"
        if isinstance(value, bool) or not isinstance(value, int | float):
            return "must be a number" + (" or null" if self.optional else "")
        if self.kind == "int" and not isinstance(value, int):
            return "must be an integer"
        # An integer past a float's range would overflow below; NaN and infinity compare false.
        if not -1e300 < value < 1e300:
            return "must be a finite number"
        if self.positive and value <= 0:
            return "must be greater than 0"
        if self.minimum is not None and value < self.minimum:
            return f"must be at least {self.minimum:g}"
        if self.maximum is not None and value > self.maximum:
            return f"must be at most {self.maximum:g}"
        return None


@dataclass(frozen=True)
class Native:
    """Features of a method's own representation (paper: "Native representation and Non-Engine rendering")."""

    connectivity: bool = False
    """Whether faces share vertices."""
    continuous_coverage: bool = False
    """Whether a primitive's weight falls off inside it."""
    binary_opacity: bool = False
    """Whether a sample is either opaque or absent, and nothing between."""
    sh: bool = False
    neural_decoder: bool = False
    alpha_compositing: bool = False


@dataclass(frozen=True)
class Retained:
    """The native features that an engine condition keeps (paper: "Condition-level engine support").

    A feature is None where the source representation has no such thing.
    """

    support: Literal["Fallback", "Method-aware"]
    appearance: str
    view_dependence: bool | None = None
    opacity: bool | None = None
    soft_coverage: bool | None = None
    depth_sort: bool | None = None
    notes: dict[str, str] = field(default_factory=dict)
    """Feature -> a remark on it, which the tables show as a footnote."""


@dataclass(frozen=True)
class PaperNote:
    """A remark on the paper's numbers of a method with its own renderer, shown as a footnote."""

    text: str
    metrics: tuple[str, ...]
    dataset: str | None = None
    """The dataset that the remark is on; None means all of them."""


@dataclass(frozen=True)
class Method:
    """The declaration of one method; docs/extending.md describes it."""

    title: str
    """The name that tables and messages print."""
    paper_name: str | None = None
    """The name in the paper's tables; None if they do not have the method."""
    paper_notes: tuple[PaperNote, ...] = ()
    native: Native | None = None
    """The features of its own representation; None if it is only shown as an extracted mesh, or not at
    all."""
    retained: dict[Tier, Retained] = field(default_factory=dict)
    """The features kept on each of the tiers `dedicated` and `standard`; a tier that is not supported is
    absent."""
    unsupported: dict[Tier, str] = field(default_factory=dict)
    """Tier -> why the method cannot be shown there; a tier not named is supported."""
    settings: dict[str, Setting] = field(default_factory=dict)
    passes: dict[Tier, tuple[str, ...]] = field(default_factory=dict)
    """Tier -> the passes a renderer needs, in order."""
    coverage: str = "solid"
    """The `coverage.kernel` of its manifests, which says how the weight falls off."""
    files: tuple[str, ...] = ()
    """Places of its models below an output folder, such as ``ckpt/{n}.ckpt``, the best one first; {n} is the
    number of an iteration, of which the last is taken, and * stands for anything, if one file alone fits."""
    bundle: tuple[str, ...] = ()
    """Names of the files that hold a model together: first the file that is read first, then those beside it.
    Any of the latter shows that a folder is of this kind."""
    reads_meshes: bool = False
    """Whether its adapter also takes any mesh file if a user names the method, because the files of its
    exporter do not show which method wrote them."""
    rules: Rules | None = None
    """The rules by which its own code reads datasets; None if it is not trained on any."""

    def supports(self, tier: Tier) -> bool:
        """Return whether the method can be shown on `tier`."""
        return tier not in self.unsupported


# What several methods declare alike.

SH_DEGREE = Setting(default=3, kind="int", minimum=0, maximum=3)
BAKED_DC = Retained("Fallback", "baked SH-DC")
AWARE: dict[str, Any] = {"view_dependence": True, "opacity": True, "depth_sort": True}
BAKED: tuple[str, ...] = ("bake_dc", "opaque_unlit")
BLENDED: tuple[str, ...] = ("project_cull", "tile_sort", "blend_front_to_back")
OTHER_LPIPS = PaperNote(
    "the paper took this LPIPS from elsewhere, of images in [0, 1]: not comparable with LPIPS on [-1, 1]",
    ("lpips",),
)
NO_APPEARANCE = "it has static colours only, no appearance of its own to draw"


def extracted_mesh(title: str, files: tuple[str, ...], rules: Rules | None) -> Method:
    """Return a method that leaves a mesh with colours in one of `files`, and needs no adapter for it."""
    return Method(
        title=title,
        retained={"standard": Retained("Fallback", "baked color")},
        unsupported={"reference": NO_APPEARANCE, "dedicated": NO_APPEARANCE},
        passes={"standard": ("opaque_unlit",)},
        files=files,
        reads_meshes=True,
        rules=rules,
    )
