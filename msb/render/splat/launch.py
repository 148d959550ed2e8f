"""How work-items share the work of the splatting kernels, one set of sizes for all of them."""

from __future__ import annotations

LANES = {"cpu": 8, "gpu": 1}
"""Number of faces, or samples of a row, that a work-item takes at once; PoCL crashes with 16
(docs/opencl.md)."""
WORK_GROUP = 64
