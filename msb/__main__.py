"""`python -m msb` is `msb`."""

from __future__ import annotations

from msb.cli import main

if __name__ == "__main__":
    main()
