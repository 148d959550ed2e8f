"""The commands `msb` and `msb-audit`: their entry points, and the kit that makes a command of a function.

A command lives in the package that does the work (`command.py`, or `commands/` where there are several). The
kit knows no command: `msb.cli.commands` lists where they are, and finds those of other packages by the
entry-point group `msb.commands`.
"""

from __future__ import annotations

import sys
import warnings
from typing import Any


def _print_warning(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
    """Print a warning of ours as one line, as errors are printed; others as Python does."""
    from msb.errors import one_line

    if category.__module__.startswith("msb."):
        print(one_line(f"warning: {message}"), file=sys.stderr)  # noqa: T201 - no command runs yet that has an Output
    else:
        _show(message, category, *rest, **more)


_show = warnings.showwarning


def main(command: str | None = None) -> None:
    """Run `msb`, or one `command` of it as a program of its own."""
    warnings.showwarning = _print_warning
    from msb.cli.app import app, single
    from msb.cli.process import run

    sys.exit(run(app if command is None else single(command), f"msb-{command}" if command else "msb"))


def main_audit() -> None:
    """Run `msb-audit`, which is `msb audit`."""
    main("audit")
