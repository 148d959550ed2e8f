"""Find commands: built-in commands in a table, other commands in the entry-point group `msb.commands`.

The module of a command is imported when the command or its help is used. Listing commands does not import
their modules.
"""

import re
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NamedTuple

from msb.base.packages import PackageError, describe_entry, find_installed, load
from msb.errors import UsageError


class Entry(NamedTuple):
    """The module of a command, and its line in the list of commands."""

    module: str
    help: str


# The module of each command, by heading and name. The module is missing if its package was not installed.
BUILT_IN: dict[str, dict[str, Entry]] = {
    "Check and repair a mesh": {
        "audit": Entry(
            "msb.api.commands.audit", "Count the defects of a mesh and report which uses it allows."
        ),
        "view": Entry("msb_viewers.commands.view", "Show the defects in a window, an image or a web page."),
        "trial": Entry("msb.trial.command", "Try common tasks on a mesh: unwrap, decimate, collide, print."),
        "repair": Entry("msb.repair.command", "Make a mesh manifold without changing its appearance."),
        "info": Entry("msb.api.commands.info", "Show the contents of an asset or a mesh file."),
        "validate": Entry("msb.api.commands.validate", "Check a file completely and list all errors."),
    },
    "Export a model": {
        "export": Entry("msb.adapters.command", "Convert a trained checkpoint to an asset, without PyTorch."),
        "convert": Entry("msb.delivery.command", "Write an asset or mesh in another format."),
        "bake": Entry("msb.bake.command", "Make an ordinary mesh that looks like the model."),
        "lod": Entry("msb.lod.command", "Make levels of detail and collision; the texture stays."),
        "score": Entry("msb.score.command", "State how near an asset is to photographs, with a certificate."),
        "why": Entry("msb.why.command", "Explain the quality loss of an export, cause by cause, in dB."),
        "methods": Entry(
            "msb.report.commands.methods", "List the methods, and their features on each renderer tier."
        ),
    },
    "Render": {
        "render": Entry("msb.render.commands.render", "Render images, depth maps and face ids."),
        "compare": Entry(
            "msb_viewers.commands.compare", "Compare the renderer tiers of a model with its photographs."
        ),
        "web": Entry("msb.engines.command", "Write a web page that shows a model in any browser."),
        "bench": Entry("msb.bench.commands.bench", "Measure frame rate and memory of an asset."),
    },
    "Benchmark": {
        "scenes": Entry("msb.scenes.commands.scenes", "Check scenes: images, splits, missing files."),
        "capture": Entry("msb.scenes.commands.capture", "Make a scene from photographs alone."),
        "run": Entry("msb.bench.commands.run", "Evaluate methods on scenes under one protocol."),
        "eval": Entry("msb.bench.commands.eval", "Compare images with photographs: PSNR, SSIM, LPIPS."),
        "submit": Entry("msb.report.commands.submit", "Package results into a single file for publication."),
        "report": Entry("msb.report.commands.report", "Make tables, charts and conclusions from results."),
        "track": Entry("msb.bench.commands.track", "Run a training and record its time and memory."),
        "demo-data": Entry(
            "msb.api.commands.demo_data", "Write small scenes and models to try the commands on."
        ),
    },
    "This machine": {
        "devices": Entry(
            "msb.render.commands.devices", "List the OpenCL devices and the renderers of this machine."
        ),
        "completion": Entry("msb.cli.completion", "Print a script for completion with the Tab key."),
    },
}
_OTHERS = "From other packages"
_NAME = r"^[a-z][a-z0-9-]{0,39}$"


def listed() -> dict[str, dict[str, str]]:
    """Return the help line of each installed command, by heading and command. No module is imported."""
    ours = {
        title: {name: place.help for name, place in places.items() if not _missing_package(place.module)}
        for title, places in BUILT_IN.items()
    }
    others = {
        name: f"From package {re.split('[.:]', value)[0]}." for name, value in _plugin_commands().items()
    }
    return {title: entries for title, entries in {**ours, _OTHERS: others}.items() if entries}


def find(name: str) -> Any:
    """Return the function of a command, or None if no command has this name.

    Raises
    ------
    UsageError
        EXTRA_MISSING: the folder of a built-in command was removed. PACKAGE_LEFT_OUT: the command of
        another package cannot be loaded.
    """
    for places in BUILT_IN.values():
        if name in places:
            module = places[name].module
            if package := _missing_package(module):
                text = f"msb {name} needs {package}, which is not part of this installation"
                raise UsageError("EXTRA_MISSING", text)
            return _function_in(import_module(module), name)
    if (value := _plugin_commands().get(name)) is None:
        return None
    try:
        return _function_in(load(value), name)
    except PackageError as error:
        raise UsageError("PACKAGE_LEFT_OUT", f"{describe_entry('command', name, value)}: {error}") from error


def _missing_package(module: str) -> str:
    """Return the package of a command if the package is not installed, otherwise an empty text."""
    parts = module.split(".")
    package = parts[0] if parts[0] != "msb" else ".".join(parts[:2])
    spec = find_spec(package)
    # After the removal of a package, its folder can still contain compiled files. Python imports a folder
    # without __init__.py as an empty package, whose `origin` is None.
    return "" if spec is not None and spec.origin is not None else package


def _plugin_commands() -> dict[str, str]:
    """Return the commands of other packages by name, with the value of their entry point."""
    ours = {name: place.module for places in BUILT_IN.values() for name, place in places.items()}
    plugins = find_installed("command", ours, lambda _, value: value, pattern=_NAME)
    return {name: value for name, (value, _) in plugins.items()}


def _function_in(loaded: Any, name: str) -> Any:
    """Return the decorated function of a command: `loaded` itself, or the function in the module `loaded`."""
    members = vars(loaded).values() if isinstance(loaded, ModuleType) else [loaded]
    functions = [member for member in members if hasattr(member, "declared")]
    named = [function for function in functions if function.name == name] or functions
    if len(named) != 1:
        raise PackageError(
            "the entry point does not name a function with the decorator msb.cli.command.command"
        )
    return named[0]
