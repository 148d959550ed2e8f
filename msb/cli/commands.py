"""Where the commands are: ours in one table, those of installed packages by their entry points.

A command's module is imported when the command is typed, or its help is asked for.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NamedTuple

from msb.base.packages import PackageError, installed, load, whose
from msb.errors import UsageError


class Place(NamedTuple):
    """The module of a command, and what the list of commands says of it."""

    module: str
    help: str


BUILT_IN: dict[str, dict[str, Place]] = {
    "Look at a mesh": {
        "audit": Place("msb.api.commands.audit", "Count a mesh's faults and say what it can be used for."),
        "view": Place("msb_viewers.commands.view", "See those faults, in a window, a picture or a page."),
        "trial": Place("msb.trial.command", "Try what artists do with it: unwrap, decimate, collide, print."),
        "repair": Place("msb.repair.command", "Make it manifold without changing its look."),
        "info": Place("msb.api.commands.info", "Show what an asset or a mesh file holds."),
        "validate": Place("msb.api.commands.validate", "List everything that is wrong with a file."),
    },
    "Take a model out": {
        "export": Place("msb.adapters.command", "Turn a trained checkpoint into an asset, without PyTorch."),
        "convert": Place("msb.delivery.command", "Write an asset or mesh in another format."),
        "bake": Place("msb.bake.command", "Make a plain mesh that looks like the model, and state its loss."),
        "why": Place("msb.why.command", "Say why an export looks worse than the render, in dB."),
        "methods": Place("msb.report.commands.methods", "List each method, and what each tier keeps of it."),
    },
    "Draw": {
        "render": Place("msb.render.commands.render", "Draw images, depths and face ids."),
        "compare": Place("msb_viewers.commands.compare", "See a model's tiers beside its photographs."),
        "web": Place("msb.engines.command", "Write a page that shows a model in any browser."),
        "bench": Place("msb.bench.commands.bench", "Measure how fast an asset is drawn, and its memory."),
    },
    "Benchmark": {
        "scenes": Place("msb.scenes.command", "Check scenes: their images, their splits, what is missing."),
        "run": Place("msb.bench.commands.run", "Evaluate methods on scenes under one protocol."),
        "eval": Place("msb.bench.commands.eval", "Compare images with photographs: PSNR, SSIM, LPIPS."),
        "submit": Place("msb.report.commands.submit", "Pack results into one file to be published."),
        "report": Place("msb.report.commands.report", "Make tables, charts and verdicts from results."),
        "track": Place("msb.bench.commands.track", "Record time and memory of a training."),
        "demo-data": Place("msb.api.commands.demo_data", "Write small scenes and models to try."),
    },
    "Machine": {
        "devices": Place("msb.render.commands.devices", "List what can compute and draw on this machine."),
        "completion": Place("msb.cli.completion", "Print the script for completion at the Tab key."),
    },
}
"""Heading of the list of commands -> command -> where it is. The folder of a command may be missing."""
_OTHERS = "From other packages"


def listed() -> dict[str, dict[str, str]]:
    """Return heading -> command -> its line of help, of all commands that are there; no module is loaded."""
    found = {
        title: {name: place.help for name, place in places.items() if _is_there(place.module)}
        for title, places in BUILT_IN.items()
    }
    others = {name: f"Of the package {value.partition('.')[0]}." for name, value in _theirs().items()}
    return {title: entries for title, entries in {**found, _OTHERS: others}.items() if entries}


def find(name: str) -> Any:
    """Return the function of a command, None if there is none of this name.

    Raises
    ------
    UsageError
        PACKAGE_LEFT_OUT: the command of another package cannot be loaded.
    """
    for places in BUILT_IN.values():
        if name in places:
            module = places[name].module
            return _function_in(import_module(module), name) if _is_there(module) else None
    if (value := _theirs().get(name)) is None:
        return None
    try:
        return _function_in(load(value), name)
    except PackageError as error:
        raise UsageError("PACKAGE_LEFT_OUT", f"{whose('command', name, value)}: {error}") from error


def _is_there(module: str) -> bool:
    """Return whether the folder of a command's capability is part of this installation."""
    parts = module.split(".")
    return find_spec(parts[0] if parts[0] != "msb" else ".".join(parts[:2])) is not None


def _theirs() -> dict[str, str]:
    ours = {name: place.module for places in BUILT_IN.values() for name, place in places.items()}
    return {name: value for name, (value, _) in installed("command", ours, lambda _, value: value).items()}


def _function_in(found: Any, name: str) -> Any:
    """Return the function that `msb.cli.command.command` decorated: `found`, or the one of that module."""
    members = vars(found).values() if isinstance(found, ModuleType) else [found]
    functions = [each for each in members if hasattr(each, "declared")]
    named = [each for each in functions if each.name == name] or functions
    if len(named) != 1:
        raise PackageError("it names no function that msb.cli.command.command decorates")
    return named[0]
