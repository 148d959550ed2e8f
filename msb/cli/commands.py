"""Find commands: ours are in one table, those of other packages are entry points of the group `msb.commands`.

The module of a command is imported when the command or its help is used, not for the list of commands.
"""

import re
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NamedTuple

from msb.base.packages import PackageError, installed, load, whose
from msb.errors import UsageError


class Place(NamedTuple):
    """The module of a command, and its line in the list of commands."""

    module: str
    help: str


# Heading -> command -> its place. The folder of a command can be missing, if its capability was removed.
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
_OTHERS = "From other packages"
_NAME = r"^[a-z][a-z0-9-]{0,39}$"


def listed() -> dict[str, dict[str, str]]:
    """Return heading -> command -> its line of help, for all installed commands. No module is loaded."""
    found = {
        title: {name: place.help for name, place in places.items() if not _missing(place.module)}
        for title, places in BUILT_IN.items()
    }
    others = {name: f"From package {re.split('[.:]', value)[0]}." for name, value in _theirs().items()}
    return {title: entries for title, entries in {**found, _OTHERS: others}.items() if entries}


def find(name: str) -> Any:
    """Return the function of a command, or None if no command has this name.

    Raises
    ------
    UsageError
        EXTRA_MISSING: the folder of one of our commands was removed. PACKAGE_LEFT_OUT: the command of another
        package cannot be loaded.
    """
    for places in BUILT_IN.values():
        if name in places:
            module = places[name].module
            if package := _missing(module):
                text = f"msb {name} needs {package}, which is not part of this installation"
                raise UsageError("EXTRA_MISSING", text)
            return _function_in(import_module(module), name)
    if (value := _theirs().get(name)) is None:
        return None
    try:
        return _function_in(load(value), name)
    except PackageError as error:
        raise UsageError("PACKAGE_LEFT_OUT", f"{whose('command', name, value)}: {error}") from error


def _missing(module: str) -> str:
    """Return the package of a command if it is not installed, else an empty text."""
    parts = module.split(".")
    package = parts[0] if parts[0] != "msb" else ".".join(parts[:2])
    spec = find_spec(package)
    # A folder that holds only compiled files of removed modules is a package without an origin.
    return "" if spec is not None and spec.origin is not None else package


def _theirs() -> dict[str, str]:
    """Return the commands of other packages: name -> value of its entry point."""
    ours = {name: place.module for places in BUILT_IN.values() for name, place in places.items()}
    found = installed("command", ours, lambda _, value: value, pattern=_NAME)
    return {name: value for name, (value, _) in found.items()}


def _function_in(found: Any, name: str) -> Any:
    """Return the decorated function of a command: `found` itself, or the one in the module `found`."""
    members = vars(found).values() if isinstance(found, ModuleType) else [found]
    functions = [member for member in members if hasattr(member, "declared")]
    named = [function for function in functions if function.name == name] or functions
    if len(named) != 1:
        raise PackageError("it does not name a function that is decorated by msb.cli.command.command")
    return named[0]
