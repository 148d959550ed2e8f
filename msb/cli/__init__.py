"""The commands `msb` and `msb-audit`: thin, over the public library. They parse, call and print."""

from __future__ import annotations

import sys


def main() -> None:
    """Run `msb`."""
    from msb.cli.app import app
    from msb.cli.run import run

    sys.exit(run(app, "msb"))


def main_audit() -> None:
    """Run `msb-audit`, which is `msb audit`."""
    from msb.cli.app import audit_app
    from msb.cli.run import run

    sys.exit(run(audit_app, "msb-audit"))
