"""Plain data: the methods, what each supports per tier, and its settings with types and defaults.

A new method is one entry here, one adapter, one kernel include and one reference module. Everything that
lists methods, tiers or settings (the manifest's checks, the command line, the feature tables) reads this
file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

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


@dataclass(frozen=True)
class Method:
    """One row of the method table."""

    title: str
    paper_name: str | None = None
    """What the paper's tables call it; None if they do not have it."""
    native: Native | None = None
    """None for what is only shown as an extracted mesh, or not at all."""
    retained: dict[Tier, Retained] = field(default_factory=dict)
    """For the two engine conditions, `dedicated` and `standard`; absent where not supported."""
    unsupported: dict[Tier, str] = field(default_factory=dict)
    """Tier -> why the method cannot be shown there; a tier not named is supported."""
    settings: dict[str, Setting] = field(default_factory=dict)
    passes: dict[Tier, tuple[str, ...]] = field(default_factory=dict)
    """Tier -> the passes a renderer needs, in order."""

    def supports(self, tier: Tier) -> bool:
        """Return whether the method can be shown on `tier`."""
        return tier not in self.unsupported


_SH_DEGREE = Setting(default=3, kind="int", minimum=0, maximum=3)
_BAKED_DC = Retained("Fallback", "baked SH-DC")
_AWARE = {"view_dependence": True, "opacity": True, "depth_sort": True}
_BAKED: tuple[str, ...] = ("bake_dc", "opaque_unlit")
_BLENDED: tuple[str, ...] = ("project_cull", "tile_sort", "blend_front_to_back")
_NO_APPEARANCE = "it has static colours only, no appearance of its own to draw"
_NOT_A_MESH = "its primitives are Gaussians, not triangles"

METHODS: dict[str, Method] = {
    "two_dts": Method(
        title="2DTS",
        paper_name="2dts",
        native=Native(continuous_coverage=True, sh=True, alpha_compositing=True),
        retained={
            "standard": _BAKED_DC,
            "dedicated": Retained("Method-aware", "SH", soft_coverage=True, **_AWARE),
        },
        settings={
            "rasterizer": Setting("2D", "choice", choices=("2D", "3D")),
            "sh_degree": _SH_DEGREE,
            "gamma": Setting(1.0, "float", minimum=1.0),
            "back_culling": Setting(False, "bool"),
            "gamma_rescale": Setting(False, "bool"),
            "ste_threshold": Setting(None, "float", minimum=0.0, maximum=1.0, optional=True),
            "render_up_scale": Setting(None, "int", minimum=1, maximum=16, optional=True),
        },
        passes={"reference": _BLENDED, "dedicated": _BLENDED, "standard": _BAKED},
    ),
    "triangle_splatting": Method(
        title="Triangle-Splatting",
        paper_name="triangle_splatting",
        native=Native(continuous_coverage=True, sh=True, alpha_compositing=True),
        retained={
            "standard": _BAKED_DC,
            "dedicated": Retained("Method-aware", "SH", soft_coverage=True, **_AWARE),
        },
        settings={
            "sh_degree": _SH_DEGREE,
            "view_dir": Setting("broadcast_z", "choice", choices=("broadcast_z", "centroid")),
        },
        passes={"reference": _BLENDED, "dedicated": _BLENDED, "standard": _BAKED},
    ),
    "mesh_splatting": Method(
        title="MeshSplatting",
        paper_name="mesh_splatting",
        native=Native(connectivity=True, sh=True, alpha_compositing=True),
        retained={"standard": _BAKED_DC, "dedicated": Retained("Method-aware", "SH", **_AWARE)},
        settings={
            "sh_degree": _SH_DEGREE,
            "supersample": Setting(4, "int", minimum=1, maximum=16),
            "opacity_floor": Setting(0.999, "float", minimum=0.0, maximum=1.0),
            "sigma": Setting(1e-4, "float", positive=True),
        },
        passes={
            "reference": (*_BLENDED, "downsample"),
            "dedicated": (*_BLENDED, "downsample"),
            "standard": _BAKED,
        },
    ),
    "diffsoup": Method(
        title="DiffSoup",
        paper_name="diffsoup",
        native=Native(binary_opacity=True, neural_decoder=True),
        retained={"dedicated": Retained("Method-aware", "MLP", **_AWARE)},
        unsupported={"standard": "its colours come from a view-dependent decoder; there is no static colour"},
        settings={
            "layout": Setting("colmap", "choice", choices=("colmap", "synthetic")),
            "z_near": Setting(0.5, "float", positive=True),
            "z_far": Setting(100.0, "float", positive=True),
        },
        passes={"reference": ("z_buffer", "decode"), "dedicated": ("z_buffer", "decode")},
    ),
    "two_dgs": Method(
        title="2DGS mesh",
        paper_name="2dgs",
        retained={"standard": Retained("Fallback", "baked color")},
        unsupported={"reference": _NO_APPEARANCE, "dedicated": _NO_APPEARANCE},
        passes={"standard": ("opaque_unlit",)},
    ),
    "three_dgs": Method(
        title="3DGS",
        paper_name="3dgs",
        unsupported=dict.fromkeys(TIERS, _NOT_A_MESH),
    ),
    "mesh": Method(
        title="mesh",
        unsupported={"reference": _NO_APPEARANCE, "dedicated": _NO_APPEARANCE},
        passes={"standard": ("opaque_unlit",)},
    ),
}
"""Manifest name -> method. `mesh` stands for any mesh that came from elsewhere."""
