"""The child process of a cross-check: python -m msb.topology.crosscheck PEER FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

from msb.topology.crosscheck.children import serve

if __name__ == "__main__":
    serve(sys.argv[1], Path(sys.argv[2]))
