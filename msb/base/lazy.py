"""Packages that import their public names at first use, and that can be called like a function."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any


class _LazyPackage(ModuleType):
    _homes: Mapping[str, str]

    def __getattr__(self, name: str) -> Any:
        if name not in self._homes:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value = getattr(import_module(self._homes[name]), name)
        setattr(self, name, value)
        return value

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._homes})

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._function(*args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:  # editors and notebooks show this signature
        return inspect.signature(self._function)

    @property
    def _function(self) -> Any:
        return getattr(self, self.__name__.rpartition(".")[2])


def make_lazy(package: str, homes: Mapping[str, str]) -> None:
    """Import the public names of a package at first use.

    Each package also contains the modules of its commands. Importing the package does not import its other
    modules, so a command's help is printed without importing NumPy.

    A package can be called if it has a public function with the package's name. For example,
    ``msb.render(asset, camera)`` calls ``msb.render.render``, and ``msb.render.images`` is still a module.

    Parameters
    ----------
    package : str
        Full name of the package, which is ``__name__`` of the caller.
    homes : mapping
        Maps each public name to the module that defines the name.
    """
    module: Any = sys.modules[package]
    module.__class__ = _LazyPackage
    module._homes = homes
