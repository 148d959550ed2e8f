"""The command tree. Importing this module must stay cheap: commands load what they need when they run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import typer
from typer.core import TyperGroup

from msb.cli import (
    audit,
    bench,
    compare,
    completion,
    config,
    convert,
    demo_data,
    devices,
    eval,
    export,
    info,
    methods,
    render,
    repair,
    report,
    run,
    scenes,
    track,
    trial,
    validate,
    view,
    web,
    why,
)
from msb.cli.help_pages import Context
from msb.cli.options import Command, Version, epilog, with_shared

_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class _Entry(NamedTuple):
    """A command: its function, the end of its help page, its line in the list of commands, and its name."""

    function: Callable[..., None]
    epilog: str
    summary: str
    name: str | None = None
    settings: dict[str, Any] = {}  # noqa: RUF012 - read only

    @property
    def typed(self) -> str:
        """What the user types."""
        return self.name or self.function.__name__


GROUPS: dict[str, tuple[_Entry, ...]] = {
    "Look at a mesh": (
        _Entry(audit.audit, audit.EPILOG, "Count a mesh's faults and say what it can be used for."),
        _Entry(view.view, view.view.epilog, "See those faults, in a window, a picture or a page."),
        _Entry(
            trial.trial,
            trial.trial.epilog,
            "Try on it what artists do: unwrap, decimate, collide, print.",
        ),
        _Entry(repair.repair, repair.repair.epilog, "Make it manifold without changing its look."),
        _Entry(info.info, info.info.epilog, "Show what an asset or a mesh file holds."),
        _Entry(validate.validate, validate.validate.epilog, "List everything that is wrong with a file."),
    ),
    "Take a model out": (
        _Entry(
            export.export, export.export.epilog, "Turn a trained checkpoint into an asset, without PyTorch."
        ),
        _Entry(convert.convert, convert.convert.epilog, "Write an asset or mesh in another format."),
        _Entry(why.why, why.why.epilog, "Say why an export looks worse than the render, in dB."),
        _Entry(
            methods.methods,
            methods.methods.epilog,
            "Say what each method has and what each tier keeps of it.",
        ),
    ),
    "Draw": (
        _Entry(render.render, render.render.epilog, "Draw images, depths and face ids."),
        _Entry(
            compare.compare, compare.compare.epilog, "See a model's looks side by side with its photographs."
        ),
        _Entry(web.web, web.web.epilog, "Write a page that shows a model in any browser."),
        _Entry(bench.bench, bench.EPILOG, "Measure how fast an asset is drawn, and its memory."),
    ),
    "Benchmark": (
        _Entry(
            scenes.scenes, scenes.scenes.epilog, "Check scenes: what is there, what counts, what is missing."
        ),
        _Entry(run.run, run.EPILOG, "Evaluate methods on scenes under one protocol."),
        _Entry(eval.evaluate, eval.EPILOG, "Compare images with photographs: PSNR, SSIM, LPIPS.", "eval"),
        _Entry(report.report, report.EPILOG, "Make tables, charts and verdicts from results."),
        _Entry(
            track.track,
            track.EPILOG,
            "Record time and memory of a training.",
            settings={**_SETTINGS, **track.CONTEXT},
        ),
        _Entry(
            demo_data.demo_data,
            demo_data.demo_data.epilog,
            "Write small scenes and models to try.",
            "demo-data",
        ),
    ),
    "Machine": (
        _Entry(devices.devices, devices.devices.epilog, "Say what can compute and draw on this machine."),
        _Entry(
            completion.completion,
            completion.completion.epilog,
            "Print what completes commands at the Tab key.",
        ),
    ),
}
"""Heading of the list of commands -> the commands below it. A command that is not here does not exist."""
_CONFIG = "Show which defaults files and variables set."


class _Group(TyperGroup):
    """The list of commands, under the headings of `GROUPS`."""

    context_class = Context

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each heading."""
        del ctx
        for title, entries in GROUPS.items():
            rows = [(entry.typed, entry.summary) for entry in entries]
            if title == "Machine":
                rows.append(("config", _CONFIG))
            with formatter.section(title):
                formatter.write_dl(rows, col_max=12)


class _Typer(typer.Typer):
    """A group whose commands are all of our class."""

    def command(self, *args: Any, **options: Any) -> Any:
        """Return the decorator that adds a command."""
        return super().command(*args, cls=Command, **options)


# Plain help text: loads in a third of the time of the framed one, and reads the same in a pipe. Completion is
# what `msb completion` prints; the library's own two options for it would be a second way.
_PLAIN: dict[str, Any] = {"rich_markup_mode": None, "context_settings": _SETTINGS, "add_completion": False}
app = _Typer(
    name="msb",
    cls=_Group,
    pretty_exceptions_enable=False,
    epilog=epilog("msb audit data_stubs/splat_like.triasset", "msb audit --help"),
    **_PLAIN,
)
for _entry in (entry for entries in GROUPS.values() for entry in entries):
    app.command(_entry.name, epilog=_entry.epilog, context_settings=_entry.settings or None)(
        _entry.function if hasattr(_entry.function, "declared") else with_shared(_entry.function)
    )

config_app = _Typer(
    help="Show the values that files and the environment give to options.",
    epilog=config.show.epilog,
    **_PLAIN,
)
config_app.command(epilog=config.show.epilog)(config.show)
app.add_typer(config_app, name="config")


@config_app.callback(invoke_without_command=True)
def _config(context: typer.Context) -> None:
    _help_alone(context)


audit_app = _Typer(name="msb-audit", pretty_exceptions_enable=False, **_PLAIN)
audit_app.command(epilog=audit.EPILOG)(with_shared(audit.audit))


@app.callback(invoke_without_command=True)
def _root(context: typer.Context, version: Version = False) -> None:
    """Decide whether a trained triangle or mesh splatting model is a usable graphics asset."""
    _help_alone(context)


def _help_alone(context: typer.Context) -> None:
    """Print the help of a group whose command is not given."""
    if context.invoked_subcommand is None:
        from msb.cli.output import echo

        echo(context.get_help())
