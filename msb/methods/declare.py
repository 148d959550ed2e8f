"""What a method declares: the classes of its plain data, and the words they use.

A method's package holds one `Method`, called ``METHOD``, in its ``__init__.py``. The registry
`msb.methods` collects them.
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
"""How primitives are ordered and sampled on the tiers that show a method's own look: docs/dedicated.md."""

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
}
"""Names a manifest's `required_passes` may use, and what each asks of a renderer."""


@dataclass(frozen=True)
class Setting:
    """What official code takes from a config or flag rather than from the checkpoint.

    Values are activated ones (`sigma` 1e-4, not its logarithm).
    """

    default: SettingValue
    kind: Literal["bool", "int", "float", "choice"]
    choices: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    positive: bool = False
    """Greater than zero, not merely not negative."""
    optional: bool = False
    """May also be None (switched off)."""

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
    """What a method's own representation has (paper: "Native representation and Non-Engine rendering")."""

    connectivity: bool = False
    """Faces share vertices."""
    continuous_coverage: bool = False
    """A primitive's weight falls off inside it."""
    binary_opacity: bool = False
    """A sample is there or not, nothing between."""
    sh: bool = False
    neural_decoder: bool = False
    alpha_compositing: bool = False


@dataclass(frozen=True)
class Retained:
    """What of it an engine condition keeps (paper: "Condition-level engine support").

    A feature is None where the source representation has no such thing.
    """

    support: Literal["Fallback", "Method-aware"]
    appearance: str
    view_dependence: bool | None = None
    opacity: bool | None = None
    soft_coverage: bool | None = None
    depth_sort: bool | None = None
    notes: dict[str, str] = field(default_factory=dict)
    """Feature -> what must be known of it; the tables show it as a footnote."""


@dataclass(frozen=True)
class PaperNote:
    """What must be known of the paper's own numbers of a method with its own renderer; a footnote there."""

    text: str
    metrics: tuple[str, ...]
    dataset: str | None = None
    """None: on all of them."""


@dataclass(frozen=True)
class Method:
    """What one method declares of itself; docs/extending.md."""

    title: str
    """As tables and messages print it."""
    paper_name: str | None = None
    """What the paper's tables call it; None if they do not have it."""
    paper_notes: tuple[PaperNote, ...] = ()
    native: Native | None = None
    """None for what is only shown as an extracted mesh, or not at all."""
    retained: dict[Tier, Retained] = field(default_factory=dict)
    """For the two engine conditions, `dedicated` and `standard`; absent where not supported."""
    unsupported: dict[Tier, str] = field(default_factory=dict)
    """Tier -> why the method cannot be shown there; a tier not named is supported."""
    settings: dict[str, Setting] = field(default_factory=dict)
    passes: dict[Tier, tuple[str, ...]] = field(default_factory=dict)
    """Tier -> the passes a renderer needs, in order."""
    coverage: str = "solid"
    """What its manifests say in `coverage.kernel`: how the weight falls off."""
    files: tuple[str, ...] = ()
    """Where its models lie below an output folder, as ``ckpt/{n}.ckpt``; {n} is the number of an iteration:
    the last is taken."""
    bundle: tuple[str, ...] = ()
    """Names of the files that hold a model together: first the one that is read first, then those beside it.
    Any of the latter tells that it is such a folder."""
    reads_meshes: bool = False
    """Its adapter takes any mesh file, too, where a user names the method: what its exporter writes does not
    tell whose it is."""
    rules: Rules | None = None
    """How its own code reads datasets; None for what is not trained on any."""

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
