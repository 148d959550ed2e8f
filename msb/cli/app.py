"""The command tree. Importing this module must stay cheap: commands load what they need when they run."""

from __future__ import annotations

from typing import Any

import typer

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
)
from msb.cli.options import Command, Version, epilog, with_shared

_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class _Typer(typer.Typer):
    """A group whose commands are all of our class."""

    def command(self, *args: Any, **options: Any) -> Any:
        """Return the decorator that adds a command."""
        return super().command(*args, cls=Command, **options)


# Plain help text: loads in a third of the time of the framed one, and reads the same in a pipe.
app = _Typer(
    name="msb",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=_SETTINGS,
    epilog=epilog("msb audit data_stubs/splat_like.triasset", "msb audit --help"),
)
app.command(epilog=audit.EPILOG)(with_shared(audit.audit))
app.command(epilog=export.EPILOG)(with_shared(export.export))
app.command(epilog=render.EPILOG)(with_shared(render.render))
app.command("eval", epilog=eval.EPILOG)(with_shared(eval.evaluate))
app.command(epilog=info.EPILOG)(with_shared(info.info))
app.command(epilog=validate.EPILOG)(with_shared(validate.validate))
app.command(epilog=convert.EPILOG)(with_shared(convert.convert))
app.command(epilog=methods.EPILOG)(with_shared(methods.methods))
app.command(epilog=scenes.EPILOG)(with_shared(scenes.scenes))
app.command(epilog=repair.EPILOG)(with_shared(repair.repair))
app.command(epilog=view.EPILOG)(with_shared(view.view))
app.command(epilog=compare.EPILOG)(with_shared(compare.compare))
app.command(epilog=web.EPILOG)(with_shared(web.web))
app.command(epilog=devices.EPILOG)(with_shared(devices.devices))
app.command(epilog=bench.EPILOG)(with_shared(bench.bench))
app.command(epilog=run.EPILOG)(with_shared(run.run))
app.command(epilog=report.EPILOG)(with_shared(report.report))
app.command(epilog=track.EPILOG, context_settings={**_SETTINGS, **track.CONTEXT})(with_shared(track.track))
app.command(epilog=trial.EPILOG)(with_shared(trial.trial))
app.command(epilog=demo_data.EPILOG)(with_shared(demo_data.demo_data))
app.command(epilog=completion.EPILOG)(with_shared(completion.completion))

config_app = _Typer(
    help="Show the values that files and the environment give to options.",
    rich_markup_mode=None,
    context_settings=_SETTINGS,
    epilog=config.EPILOG,
)
config_app.command(epilog=config.EPILOG)(with_shared(config.show))
app.add_typer(config_app, name="config")

audit_app = _Typer(
    name="msb-audit", rich_markup_mode=None, pretty_exceptions_enable=False, context_settings=_SETTINGS
)


@app.callback()
def _root(version: Version = False) -> None:
    """Decide whether a trained triangle or mesh splatting model is a usable graphics asset."""


audit_app.command(epilog=audit.EPILOG)(with_shared(audit.audit))
