"""`python -m msb` is `msb`."""

from __future__ import annotations

from msb.cli import main

main()
