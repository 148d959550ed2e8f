"""Packages of the public API that are called like the function of their name, such as `msb.render`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    _function: Callable[..., Any]

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._function(*args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.signature(self._function)


def make_callable(name: str, function: Callable[..., Any]) -> None:
    """Let the package `name` be called as `function`, and `help` of it show how.

    ``msb.render(asset, camera)`` is then the function, whatever was imported first, and ``msb.render.images``
    still is a module.
    """
    package: Any = sys.modules[name]
    package.__class__ = _Callable
    package._function = function
    summary, _, rest = (inspect.getdoc(function) or "").partition("\n\n")
    parameters = [
        one.replace(annotation=one.empty) for one in inspect.signature(function).parameters.values()
    ]
    about = inspect.cleandoc(package.__doc__ or "")
    package.__doc__ = (
        f"{summary}\n\nCall it: {name}{inspect.Signature(parameters)}\n\n{rest}\n\nThe package: {about}"
    )
