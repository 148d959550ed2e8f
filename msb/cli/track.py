"""`msb track`: what a training costs, measured while it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from msb.cli.options import WRITTEN, Force, Quiet, Verbose, epilog
from msb.cli.output import Output

if TYPE_CHECKING:
    from msb.bench.records import RendererTiming
    from msb.bench.track import Track

EPILOG = epilog(
    'msb track -- python -c "print(sum(range(10**6)))"',
    "msb track -o out/track.json -- python --version",
    "msb track --frames 8 -o out/own.json -- python --version",
)
CONTEXT = {"ignore_unknown_options": True, "allow_interspersed_args": False}
"""Options after the name of the command to run belong to that command."""


def track(
    command: Annotated[
        list[str], typer.Argument(metavar="COMMAND...", help="The command to run, passed on unchanged.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="Where the record goes."), WRITTEN
    ] = Path("track.json"),
    frames: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Write how fast a renderer is that draws N images."),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Run a training and record wall time, peak GPU memory and peak RAM, of it and of all it starts.

    The exit status is the command's, or 128 + n if signal n ended it. A protocol's key training takes the
    record. With --frames the command is a method's own renderer, and a protocol's key
    non_engine_timing takes the record: it says that loading and writing are included. GPU memory is
    measured by NVML (NVIDIA, extra gpu); if that is missing the record says why.
    """
    from msb.base.atomic import new_file
    from msb.bench.track import timing_of_command
    from msb.bench.track import track as run

    output = Output(None, quiet, verbose, force)
    output.check_free(out)
    found = run(command)
    try:
        if frames is None:
            record: Track | RendererTiming = found
        elif found.exit_status == 0:
            record = timing_of_command(found, frames)
        else:
            output.note(f"{out}: not written, the command ended with status {found.exit_status}")
            raise typer.Exit(found.exit_status)
        with new_file(out) as file:
            file.write(record.to_json())
    finally:  # it is said even if it cannot be kept: a training is not run twice for this
        output.note(_summary(found, out))
    raise typer.Exit(found.exit_status)


def _summary(found: Track, out: Path) -> str:
    gpu = found.peak_gpu_memory_bytes
    parts = [f"{found.seconds / 60:.1f} min" if found.seconds >= 60 else f"{found.seconds:.1f} s"]
    parts.append(f"GPU not measured ({found.gpu_reason})" if gpu is None else f"GPU {gpu / 2**20:,.0f} MiB")
    if found.peak_host_memory_bytes is not None:
        parts.append(f"RAM {found.peak_host_memory_bytes / 2**20:,.0f} MiB")
    return f"{out}: {', '.join(parts)}"
