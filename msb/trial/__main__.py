"""The child process of a trial: python -m msb.trial TASK LIBRARY FOLDER MEMORY."""

from __future__ import annotations

import sys
from pathlib import Path

from msb.trial.children import serve

if __name__ == "__main__":
    serve(sys.argv[1], sys.argv[2], Path(sys.argv[3]), float(sys.argv[4]))
