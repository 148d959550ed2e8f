"""The registry of methods: our own, each a folder of this package, and those that installed packages bring.

A method is a package whose ``__init__.py`` declares a `Method` called ``METHOD``, plain data that costs
nothing to read. Its code lies beside it, in modules named after their roles, which are imported when they are
needed:

- ``adapter`` turns what its training writes into an asset (`msb.adapters.exporter.Adapter`);
- ``official`` writes what its own exporter would write (`msb.adapters.official.Official`);
- ``reference`` forms its image in NumPy (``render``, as `msb.reference` calls it);
- ``look`` forms the same image on the dedicated tier, with its kernels (`msb.render.dedicated`).

Everything that lists methods, tiers or settings reads `METHODS`. Other packages add methods through the
entry-point group `msb.methods` (docs/extending.md).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from msb.errors import shorten
from msb.methods.declare import (
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

if TYPE_CHECKING:
    from types import ModuleType

__all__ = [
    "METHODS",
    "ORDERS",
    "PASSES",
    "SAMPLINGS",
    "SETTING_SOURCES",
    "TIERS",
    "Method",
    "MethodWarning",
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

GROUP = "msb.methods"
"""The entry-point group of methods; an entry is ``name = "package"``."""
BUILT_IN = (
    "two_dts",
    "triangle_splatting",
    "mesh_splatting",
    "diffsoup",
    "two_dgs",
    "three_dgs",
    "mesh",
)
"""Folders of our methods, in the order of the tables. `mesh` stands for any mesh that came from elsewhere."""
NAME = r"^[a-z][a-z0-9_]{0,63}$"
"""The pattern of a method's name, in manifests and in the entry-point group."""

Role = Literal["adapter", "official", "reference", "look"]


class MethodWarning(UserWarning):
    """A warning that a package's method cannot be used; the other methods can."""


class _Installed(NamedTuple):
    method: Method
    package: str


class _Methods(Mapping[str, Method]):
    """Name -> method; looked up on first use, since a package that declares one imports this module."""

    def __getitem__(self, name: str) -> Method:
        return _installed()[name].method

    def __iter__(self) -> Iterator[str]:
        return iter(_installed())

    def __len__(self) -> int:
        return len(_installed())


METHODS: Mapping[str, Method] = _Methods()
"""Name in manifests -> method: first ours in the order of the tables, then those of installed packages by
name."""


@cache
def _installed() -> dict[str, _Installed]:
    found = {}
    for name in BUILT_IN:
        package = f"{__name__}.{name}"
        found[name] = _Installed(import_module(package).METHOD, package)
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value)):
        if entry.name in found and found[entry.name].package == entry.value:
            continue  # one installation, seen twice
        problem = _name_problem(entry.name, found)
        if problem is None:
            try:
                declared = import_module(entry.value).METHOD
                if isinstance(declared, Method):
                    found[entry.name] = _Installed(declared, entry.value)
                    continue
                problem = "METHOD is no msb.methods.Method"
            except Exception as error:
                problem = f"it cannot be loaded: {type(error).__name__}: {shorten(str(error), 200)}"
        warn(entry.name, entry.value, problem)
    return found


def _name_problem(name: str, found: Mapping[str, _Installed]) -> str | None:
    if name in found:
        return f"the name is taken by {found[name].package}"
    return None if re.match(NAME, name) else f"its name must match {NAME}"


def warn(name: str, package: str, problem: str) -> None:
    """Warn that the method `name` of a package is left out, and why."""
    where = f"method {shorten(name, 40)} of package {shorten(package, 80)}"
    text = f"METHOD_NOT_LOADED: {where} is left out: {problem}"
    warnings.warn(text, MethodWarning, stacklevel=2)


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
    return _installed()[name].package


def role(name: str, what: Role) -> ModuleType | None:
    """Return the module by which an installed method fills a role, None if it does not.

    Raises
    ------
    ImportError
        Another package's module cannot be imported. Other errors of that module are raised as they are.
    """
    if name not in METHODS:
        return None
    module = f"{package_of(name)}.{what}"
    return import_module(module) if find_spec(module) else None


def with_role(what: Role) -> Iterator[tuple[str, Any]]:
    """Yield name and module of all methods that fill a role; one that cannot be imported is a warning."""
    for name in METHODS:
        module = _loadable(name, what)
        if module is not None:
            yield name, module


@cache
def _loadable(name: str, what: Role) -> ModuleType | None:
    try:
        return role(name, what)
    except Exception as error:
        if name in BUILT_IN:
            raise
        problem = f"its {what} cannot be loaded: {type(error).__name__}: {shorten(str(error), 200)}"
        warn(name, package_of(name), problem)
        return None
