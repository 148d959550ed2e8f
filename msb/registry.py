"""The registry of methods: built-in methods in the folders of `msb.methods`, and methods of other packages.

A method is a package whose ``__init__.py`` declares a `Method` named ``METHOD``, which is plain data. The
code of a method is in modules of its package, which are imported on demand. Each module of a method's package
has a role:

- ``adapter`` converts the files of a trained model to an asset (`msb.adapters.exporter.Adapter`). A method
  needs no adapter if it writes coloured meshes with a recognisable file name.

- ``official`` writes the same file as the method's own exporter (`msb.adapters.official.Official`).

- ``reference`` renders the method's image in NumPy (``render``, called by `msb.reference`).

- ``native`` renders the same image on the dedicated tier, with OpenCL kernels (`msb.render.dedicated`).

All lists of methods, tiers or settings are read from `METHODS`. Other packages can add methods with the
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

from msb.base.packages import Lazy, PackageError, contain_errors, describe_entry, find_installed, load, warn
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from msb.scenes.datasets.rules import Rules

Tier = Literal["reference", "dedicated", "standard"]
TIERS: tuple[Tier, ...] = ("reference", "dedicated", "standard")

Order = Literal["tile", "global", "none"]
ORDERS: tuple[Order, ...] = ("tile", "global", "none")
Sampling = Literal["official", "engine"]
# How native rendering orders and samples primitives. docs/dedicated.md explains the choices.
SAMPLINGS: tuple[Sampling, ...] = ("official", "engine")

SettingValue = bool | int | float | str | None
SettingSource = Literal["checkpoint", "config", "flag", "default"]
SETTING_SOURCES: tuple[str, ...] = ("checkpoint", "config", "flag", "default")

# Description of each rendering pass, by its name in the manifest key `required_passes`.
PASSES: dict[str, str] = {
    "opaque_unlit": "opaque, z-buffered, two-sided faces in unlit vertex colours; every engine can draw "
    "such faces",
    "bake_dc": "clamp(C0 * f_dc + 0.5), converted to vertex colours before drawing",
    "project_cull": "per-primitive projection, culling and appearance",
    "tile_sort": "assignment to tiles and stable depth sort within each tile",
    "blend_front_to_back": "front-to-back compositing with the method's coverage and stop rule",
    "z_buffer": "nearest face per pixel with the method's opacity test",
    "decode": "neural decoder of the lattice features at each pixel",
    "downsample": "box filter from the supersampled raster to the image",
    "opaque_unlit_texture": "like opaque_unlit, with textures in linear light, multiplied by the colours",
}


@dataclass(frozen=True)
class Setting:
    """A parameter that the official code reads from a config file or a flag, not from the checkpoint.

    Values are stored after activation: `sigma` is 1e-4, not the logarithm of 1e-4.
    """

    default: SettingValue
    kind: Literal["bool", "int", "float", "choice"]
    choices: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    positive: bool = False
    """Whether the value must be greater than zero."""
    optional: bool = False
    """Whether the value can be None, which switches the setting off."""

    def problem(self, value: object) -> str | None:
        """Return why `value` is invalid, as text that begins with "must", or None if it is valid."""
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
        # The comparison also rejects NaN, infinity, and integers that are too large for a float.
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
    """Features of a method's native representation.

    Paper: "Native representation and Non-Engine rendering".
    """

    connectivity: bool = False
    """Whether faces share vertices."""
    continuous_coverage: bool = False
    """Whether the weight varies inside a primitive."""
    binary_opacity: bool = False
    """Whether a sample is either opaque or absent."""
    sh: bool = False
    neural_decoder: bool = False
    alpha_compositing: bool = False


@dataclass(frozen=True)
class Retained:
    """The native features that an engine condition retains (paper: "Condition-level engine support").

    A feature is None if the native representation does not have it.
    """

    support: Literal["Fallback", "Method-aware"]
    appearance: str
    view_dependence: bool | None = None
    opacity: bool | None = None
    soft_coverage: bool | None = None
    depth_sort: bool | None = None
    notes: dict[str, str] = field(default_factory=dict)
    """A remark on a feature, which the tables show as a footnote."""


@dataclass(frozen=True)
class PaperNote:
    """A footnote of tables: a remark on the paper's numbers for a method in native rendering."""

    text: str
    metrics: tuple[str, ...]
    # The dataset to which the footnote applies; None means all datasets.
    dataset: str | None = None


@dataclass(frozen=True)
class Method:
    """The declaration of one method. docs/extending.md describes the declaration."""

    title: str
    """The name of the method in tables and messages."""
    paper_name: str | None = None
    """The name of the method in the paper's tables; None if the paper does not have the method."""
    paper_notes: tuple[PaperNote, ...] = ()
    native: Native | None = None
    """The features of the method's native representation; None if the method has no native rendering."""
    retained: dict[Tier, Retained] = field(default_factory=dict)
    """The features that each supported tier (`dedicated`, `standard`) retains."""
    unsupported: dict[Tier, str] = field(default_factory=dict)
    """The reason why the method does not support a tier. The method supports all other tiers."""
    settings: dict[str, Setting] = field(default_factory=dict)
    passes: dict[Tier, tuple[str, ...]] = field(default_factory=dict)
    """The passes of each tier's renderer, in order."""
    coverage: str = "solid"
    """The value of `coverage.kernel` in manifests: the name of the weight function inside a primitive."""
    primitive: Literal["triangle", "gaussian"] = "triangle"
    """The primitives that the method trains. Meshes extracted from Gaussians become assets of triangles."""
    files: tuple[str, ...] = ()
    """Paths of the method's models in an output folder, such as ``ckpt/{n}.ckpt``.

    The preferred path is first. {n} is the iteration number, and the highest number is used. A * matches any
    text, if only one file matches.
    """
    bundle: tuple[str, ...] = ()
    """File names of a model that consists of several files; the main file is first.

    A folder with any of the other files is recognised as a model of this method.
    """
    reads_meshes: bool = False
    """Whether the method's adapter accepts any mesh file if the user names the method.

    Methods need this option if their exported files do not identify the method.
    """
    rules: Rules | None = None
    """The rules of the official code for reading datasets, or None if the method is not trained on
    datasets."""

    def supports(self, tier: Tier) -> bool:
        """Return whether `tier` can draw models of the method."""
        return tier not in self.unsupported


# Declarations that several methods share.

SH_DEGREE = Setting(default=3, kind="int", minimum=0, maximum=3)
SPLAT_SH_DEGREE = Setting(default=3, kind="int", minimum=0, maximum=4)
# The rules for drawing Gaussians: from the method's official code, or from gsplat.
SPLAT_RASTERIZER = Setting("official", "choice", choices=("official", "gsplat"))
BAKED_DC = Retained("Fallback", "baked SH-DC")
AWARE: dict[str, Any] = {"view_dependence": True, "opacity": True, "depth_sort": True}
BAKED: tuple[str, ...] = ("bake_dc", "opaque_unlit")
BLENDED: tuple[str, ...] = ("project_cull", "tile_sort", "blend_front_to_back")
OTHER_LPIPS = PaperNote(
    "the paper cites LPIPS of images in [0, 1] from other work; our LPIPS uses images in [-1, 1] and is not "
    "comparable",
    ("lpips",),
)
NO_TRIANGLES = "the primitives of this method are Gaussians, not triangles"
NO_APPEARANCE = "the model is a mesh with static colours and has no native rendering"


def extracted_mesh(title: str, files: tuple[str, ...], rules: Rules | None) -> Method:
    """Return the declaration of a method without an adapter.

    The method's training writes a coloured mesh to a file with a name in `files`.
    """
    return Method(
        title=title,
        retained={"standard": Retained("Fallback", "baked color")},
        unsupported={"reference": NO_APPEARANCE, "dedicated": NO_APPEARANCE},
        passes={"standard": ("opaque_unlit",)},
        files=files,
        reads_meshes=True,
        rules=rules,
    )


# The registry of installed methods and their modules.

# Folders of the built-in methods, in the order of tables. The method `mesh` represents meshes from any other
# source.
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
Role = Literal["adapter", "official", "reference", "native"]


def _methods() -> Mapping[str, Method]:
    return {name: method for name, (method, _) in _installed().items()}


# All methods by their name in manifests. Built-in methods come first, in the order of tables.
METHODS: Mapping[str, Method] = Lazy(_methods)


@cache
def _installed() -> dict[str, tuple[Method, str]]:
    """Return the methods and their packages by name."""
    places = {name: f"msb.methods.{name}" for name in BUILT_IN}
    ours = {name: (import_module(place).METHOD, place) for name, place in places.items()}
    return ours | find_installed("method", places, _load_declared)


def _load_declared(_: str, value: str) -> Method:
    method = load(f"{value}:METHOD")
    if not isinstance(method, Method):
        raise PackageError("METHOD is not an msb.registry.Method")
    return method


def lookup(name: str) -> Method:
    """Return the method with this name. A method that is not installed supports only the standard tier.

    The manifest of an asset is sufficient to audit it, convert it and draw it as an opaque mesh.
    """
    if name in METHODS:
        return METHODS[name]
    why = f"the method {shorten(name, 64)} is not installed"
    return Method(title=name, unsupported={"reference": why, "dedicated": why})


def package_of(name: str) -> str:
    """Return the Python package of an installed method.

    The OpenCL kernels of the method are in the same folder.
    """
    return _installed()[name][1]


def role(name: str, what: Role) -> Any:
    """Return the module of an installed method for a role, or None if the method has no such module.

    If a module of another package fails to load, or one of its functions fails, `PACKAGE_LEFT_OUT` is raised.
    """
    if name not in METHODS:
        return None
    module = f"{package_of(name)}.{what}"
    if name in BUILT_IN:
        return import_module(module) if find_spec(module) else None
    with _naming_package(name, f"{what}: "):
        loaded = load(module) if _exists(module) else None
    return loaded and _PluginModule(loaded, name, what)


def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # the method is a single module, so it has no roles
        return False


class _PluginModule:
    """A module of a method from another package. Errors in the module's functions name the package."""

    def __init__(self, module: ModuleType, method: str, what: Role) -> None:
        self._module, self._method, self._what = module, method, what

    def __getattr__(self, name: str) -> Any:
        member = getattr(self._module, name)
        if not isinstance(member, FunctionType):
            return member

        @wraps(member)
        def call(*args: Any, **options: Any) -> Any:
            with _naming_package(self._method, f"{self._what} fails: "), contain_errors():
                return member(*args, **options)

        return call


@contextmanager
def _naming_package(method: str, doing: str) -> Iterator[None]:
    """Convert a `PackageError` to `PACKAGE_LEFT_OUT`, with the package of the method in the message."""
    try:
        yield
    except PackageError as error:
        text = f"{describe_entry('method', method, package_of(method))}: {doing}{error}"
        raise UsageError("PACKAGE_LEFT_OUT", text) from error.__cause__


def with_role(what: Role) -> Iterator[tuple[str, Any]]:
    """Yield the name and the module of each method with a module for a role.

    A module that cannot be imported causes a warning.
    """
    for name in METHODS:
        module = _loadable(name, what)
        if module is not None:
            yield name, module


@cache
def _loadable(name: str, what: Role) -> Any:
    """Return the module of a role. If the module cannot be imported, warn and return None."""
    try:
        return role(name, what)
    except UsageError as error:
        warn(str(error))
        return None
