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
from functools import cache, wraps
from importlib import import_module
from importlib.util import find_spec
from types import FunctionType, ModuleType
from typing import Any, Literal

from msb.base.packages import (
    NAME,
    Lazy,
    PackageError,
    contained,
    installed,
    load,
    warn,
    whose,
)
from msb.errors import UsageError, shorten
from msb.registry.declare import (
    ORDERS,
    PASSES,
    SAMPLINGS,
    SETTING_SOURCES,
    TIERS,
    Method,
    Native,
    Order,
    Retained,
    Sampling,
    Setting,
    SettingSource,
    SettingValue,
    Tier,
)

__all__ = [
    "METHODS",
    "NAME",
    "ORDERS",
    "PASSES",
    "SAMPLINGS",
    "SETTING_SOURCES",
    "TIERS",
    "Method",
    "Native",
    "Order",
    "Retained",
    "Role",
    "Sampling",
    "Setting",
    "SettingSource",
    "SettingValue",
    "Tier",
    "lookup",
    "package_of",
    "role",
]

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
"""Folders of our methods, in the order of the tables. `mesh` stands for any mesh that came from elsewhere."""
Role = Literal["adapter", "official", "reference", "look"]


def _methods() -> Mapping[str, Method]:
    return {name: method for name, (method, _) in _installed().items()}


METHODS: Mapping[str, Method] = Lazy(_methods)
"""Name in manifests -> method: first ours in the order of the tables, then those of installed packages by
name."""


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
