"""How fast a method's own renderer is, as the user measured it: a small JSON file (docs/protocol.md)."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from msb.bench.checked import checked, read_json
from msb.bench.records import RendererTiming

if TYPE_CHECKING:
    from msb.bench.track import Track

WHOLE_COMMAND = "whole command, loading and writing included"
_MAX_BYTES = 1 << 16


def read_renderer_timing(path: str | os.PathLike[str]) -> RendererTiming:
    """Return the measurement in the file `path`."""
    return checked(RendererTiming, read_json(path, _MAX_BYTES), file=path, code="RECORD_INVALID")


def timing_of_command(found: Track, frames: int) -> RendererTiming:
    """Return what a command that drew `frames` images says of its renderer: a bound of its time."""
    device = ", ".join(gpu.name for gpu in found.gpus) or str(found.machine.get("host", "unknown"))
    return RendererTiming(
        frames=frames,
        seconds=found.seconds,
        device=device,
        timed=WHOLE_COMMAND,
        whole_command=True,
        peak_gpu_memory_bytes=found.peak_gpu_memory_bytes,
    )
