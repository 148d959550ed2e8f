"""The commands `msb` and `msb-audit`, a thin layer over the public library: they parse, call and print."""

from __future__ import annotations

import sys
import warnings
from typing import Any


def _plainly(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
    """Print a warning of ours as one line, as errors are printed; others as Python does."""
    from msb.errors import one_line

    if category.__module__.startswith("msb."):
        print(one_line(f"warning: {message}"), file=sys.stderr)  # noqa: T201 - no command runs yet that has an Output
    else:
        _show(message, category, *rest, **more)


_show = warnings.showwarning


def main() -> None:
    """Run `msb`."""
    warnings.showwarning = _plainly
    from msb.cli.app import app
    from msb.cli.process import run

    sys.exit(run(app, "msb"))


def main_audit() -> None:
    """Run `msb-audit`, which is `msb audit`."""
    warnings.showwarning = _plainly
    from msb.cli import audit
    from msb.cli.app import single
    from msb.cli.process import run

    sys.exit(run(single(audit, "audit"), "msb-audit"))
