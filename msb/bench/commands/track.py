"""`msb track`: what a training costs, measured while it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msb.base.option import Argument, Option
from msb.cli.command import command
from msb.cli.output import PlainOutput, file_option, is_stdout
from msb.errors import UsageError

if TYPE_CHECKING:
    from msb.bench.records import RendererTiming
    from msb.bench.track import Track


@command(
    'msb track -- python -c "print(sum(range(10**6)))"',
    "msb track -o out/track.json -- python --version",
    "msb track --frames 8 -o out/own.json -- python --version",
    # Options after the name of the command to run belong to that command.
    ignore_unknown_options=True,
    allow_interspersed_args=False,
)
def track(
    command: Annotated[
        tuple[str, ...], Argument("The command to run, passed on unchanged.", metavar="COMMAND...")
    ],
    out: Annotated[Path, file_option("Where the record goes.", "--out", "-o")] = Path("track.json"),
    frames: Annotated[
        int | None,
        Option("Write how fast a renderer is that draws N images.", metavar="N", least=1),
    ] = None,
    *,
    output: PlainOutput,
) -> int:
    """Run a training and record wall time, peak GPU memory and peak RAM, of it and of all it starts.

    The exit status is the command's, or 128 + n if signal n ended it. A protocol's key training takes the
    record. With --frames the command is a method's own renderer, and a protocol's key
    non_engine_timing takes the record: it says that loading and writing are included. GPU memory is
    measured by NVML (NVIDIA, extra gpu); if that is missing the record says why.
    """
    from msb.base.atomic import new_file
    from msb.bench.track import timing_of_command
    from msb.bench.track import track as run

    if is_stdout(out):
        raise UsageError("USAGE", "--out: standard output is that of COMMAND; name a file")
    record = run(list(command))
    try:
        if frames is not None and record.exit_status != 0:
            output.note(f"{out}: not written, the command ended with status {record.exit_status}")
            return record.exit_status
        written: Track | RendererTiming = record if frames is None else timing_of_command(record, frames)
        with new_file(out, overwrite=output.force) as file:
            file.write(written.to_json())
    finally:  # it is said even if it cannot be kept: a training is not run twice for this
        output.note(_summary(record, out))
    return record.exit_status


def _summary(record: Track, out: Path) -> str:
    gpu = record.peak_gpu_memory_bytes
    parts = [f"{record.seconds / 60:.1f} min" if record.seconds >= 60 else f"{record.seconds:.1f} s"]
    parts.append(f"GPU not measured ({record.gpu_reason})" if gpu is None else f"GPU {gpu / 2**20:,.0f} MiB")
    if record.peak_host_memory_bytes is not None:
        parts.append(f"RAM {record.peak_host_memory_bytes / 2**20:,.0f} MiB")
    return f"{out}: {', '.join(parts)}"
