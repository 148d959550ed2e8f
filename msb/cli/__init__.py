"""The entry points of the programs `msb` and `msb-audit`, and the code that turns functions into commands.

The module of a command is in the package that does its work, as `command.py` or in `commands/`.
`msb.cli.commands` lists the modules of all commands, and finds commands of other packages in the
entry-point group `msb.commands`.
"""

import sys
import warnings
from typing import Any


def _print_warning(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
    """Print a warning of this project as one line. Print other warnings in Python's format."""
    from msb.errors import one_line

    if category.__module__.startswith("msb."):
        print(one_line(f"warning: {message}"), file=sys.stderr)  # noqa: T201 - no command has started yet
    else:
        _show(message, category, *rest, **more)


_show = warnings.showwarning


def main(command: str | None = None) -> None:
    """Run `msb`, or the program of a single `command`."""
    warnings.showwarning = _print_warning
    from msb.cli.app import app, single
    from msb.cli.process import run

    sys.exit(run(app if command is None else single(command), f"msb-{command}" if command else "msb"))


def main_audit() -> None:
    """Run `msb-audit`, which is `msb audit`."""
    main("audit")
