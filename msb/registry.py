"""The registry of methods: our own, each a folder of `msb.methods`, and those that installed packages bring.

A method is a package whose ``__init__.py`` declares a `Method` called ``METHOD``, plain data that costs
nothing to read. Its code lies beside it, in modules named after their roles, which are imported when they are
needed:

- ``adapter`` turns what its training writes into an asset (`msb.adapters.exporter.Adapter`); a mesh with
  colours needs none where its file's name says whose it is;
- ``official`` writes what its own exporter would write (`msb.adapters.official.Official`);
- ``reference`` forms its image in NumPy (``render``, as `msb.reference` calls it);
- ``look`` forms the same image on the dedicated tier, with its kernels (`msb.render.dedicated`).

Everything that lists methods, tiers or settings reads `METHODS`. Other packages add methods through the
entry-point group `msb.methods` (docs/extending.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, wraps
from importlib import import_module
from importlib.util import find_spec
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Literal

from msb.base.packages import Lazy, PackageError, contained, installed, load, warn, whose
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from msb.scenes.datasets.rules import Rules

Tier = Literal["reference", "dedicated", "standard"]
TIERS: tuple[Tier, ...] = ("reference", "dedicated", "standard")

Order = Literal["tile", "global", "none"]
ORDERS: tuple[Order, ...] = ("tile", "global", "none")
Sampling = Literal["official", "engine"]
# The ways to order and sample primitives on the tiers that show a method's own look; see
# docs/dedicated.md.
SAMPLINGS: tuple[Sampling, ...] = ("official", "engine")

SettingValue = bool | int | float | str | None
SettingSource = Literal["checkpoint", "config", "flag", "default"]
SETTING_SOURCES: tuple[str, ...] = ("checkpoint", "config", "flag", "default")

# Name that a manifest's `required_passes` may use -> what the pass asks of a renderer.
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
    # The dataset that the remark is on; None means all of them.
    dataset: str | None = None


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


# The registry: the methods that are installed, and their modules.

# Folders of our methods, in the order of the tables. `mesh` stands for any mesh that came from elsewhere.
BUILT_IN = (
    "two_dts",
    "triangle_splatting",
    "mesh_splatting",
    "triangle_splatting_plus",
    "diffsoup",
    "two_dgs",
    "three_dgs",
    "milo",
    "gaussian_wrapping",
    "trisplat",
    "sugar",
    "frosting",
    "mesh",
)
Role = Literal["adapter", "official", "reference", "look"]


def _methods() -> Mapping[str, Method]:
    return {name: method for name, (method, _) in _installed().items()}


# Name in manifests -> method: first ours in the order of the tables, then those of installed packages by
# name.
METHODS: Mapping[str, Method] = Lazy(_methods)


@cache
def _installed() -> dict[str, tuple[Method, str]]:
    """Return name -> method and the package that it lives in."""
    places = {name: f"msb.methods.{name}" for name in BUILT_IN}
    ours = {name: (import_module(place).METHOD, place) for name, place in places.items()}
    return ours | installed("method", places, _declared)


def _declared(_: str, value: str) -> Method:
    method = load(f"{value}:METHOD")
    if not isinstance(method, Method):
        raise PackageError("METHOD is no msb.registry.Method")
    return method


def lookup(name: str) -> Method:
    """Return the method called `name`; one that is not installed gets the standard tier alone.

    The manifest of an asset of such a method is enough to audit it, convert it and draw it as an opaque mesh.
    """
    if name in METHODS:
        return METHODS[name]
    why = f"the method {shorten(name, 64)} is not installed"
    return Method(title=name, unsupported={"reference": why, "dedicated": why})


def package_of(name: str) -> str:
    """Return the package that an installed method lives in, kernels and all."""
    return _installed()[name][1]


def role(name: str, what: Role) -> Any:
    """Return the module by which an installed method fills a role, None if it does not.

    A package's module that cannot be loaded, or a function of it that fails, is `PACKAGE_LEFT_OUT`.
    """
    if name not in METHODS:
        return None
    module = f"{package_of(name)}.{what}"
    if name in BUILT_IN:
        return import_module(module) if find_spec(module) else None
    with _blaming(name, f"its {what}: "):
        loaded = load(module) if _exists(module) else None
    return loaded and _Theirs(loaded, name, what)


def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # the method is a module of its own, without roles
        return False


class _Theirs:
    """A module of another package; what its functions do wrong is said to be theirs."""

    def __init__(self, module: ModuleType, method: str, what: Role) -> None:
        self._module, self._method, self._what = module, method, what

    def __getattr__(self, name: str) -> Any:
        member = getattr(self._module, name)
        if not isinstance(member, FunctionType):
            return member

        @wraps(member)
        def call(*args: Any, **options: Any) -> Any:
            with _blaming(self._method, f"its {self._what} fails: "), contained():
                return member(*args, **options)

        return call


@contextmanager
def _blaming(method: str, doing: str) -> Iterator[None]:
    try:
        yield
    except PackageError as error:
        text = f"{whose('method', method, package_of(method))}: {doing}{error}"
        raise UsageError("PACKAGE_LEFT_OUT", text) from error.__cause__


def with_role(what: Role) -> Iterator[tuple[str, Any]]:
    """Yield name and module of all methods that fill a role; one that cannot be imported is a warning."""
    for name in METHODS:
        module = _loadable(name, what)
        if module is not None:
            yield name, module


@cache
def _loadable(name: str, what: Role) -> Any:
    try:
        return role(name, what)
    except UsageError as error:
        warn(str(error))
        return None
