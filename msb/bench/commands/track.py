"""`msb track`: measure the time and memory of a training run."""

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
    # options after the name of the command are passed to the command
    ignore_unknown_options=True,
    allow_interspersed_args=False,
)
def track(
    command: Annotated[
        tuple[str, ...], Argument("The command to run, passed on unchanged.", metavar="COMMAND...")
    ],
    out: Annotated[Path, file_option("Write the record to FILE.", "--out", "-o")] = Path("track.json"),
    frames: Annotated[
        int | None,
        Option(
            "Measure a renderer that draws N images, and write its timing. Default: record a training.",
            metavar="N",
            least=1,
        ),
    ] = None,
    *,
    output: PlainOutput,
) -> int:
    """Run a training and record its time, peak GPU memory and peak RAM, including child processes.

    The exit status is the status of the command, or 128 + n if signal n ended the command. To use the record
    of a training run, name its file in the key training of a protocol. With --frames, the command is a
    method's official renderer. To use the record of a renderer, name its file in the key non_engine_timing.
    With --frames, the record states that its time includes loading and writing. GPU memory is measured by
    NVML (NVIDIA only, extra gpu). If GPU memory cannot be measured, the record gives the reason.
    """
    from msb.base.atomic import new_file
    from msb.bench.track import make_renderer_timing
    from msb.bench.track import track as run

    if is_stdout(out):
        text = "--out must be a file, because standard output belongs to COMMAND"
        raise UsageError("USAGE", text)
    record = run(list(command))
    try:
        if frames is not None and record.exit_status != 0:
            output.note(f"{out} was not written, because the command failed with status {record.exit_status}")
            return record.exit_status
        written: Track | RendererTiming = record if frames is None else make_renderer_timing(record, frames)
        with new_file(out, overwrite=output.force) as file:
            file.write(written.to_json())
    finally:  # print the result even if writing fails, because repeating a training takes hours
        output.note(_summarize(record, out))
    return record.exit_status


def _summarize(record: Track, out: Path) -> str:
    """Return the time and memory of a command as one line."""
    gpu = record.peak_gpu_memory_bytes
    parts = [f"{record.seconds / 60:.1f} min" if record.seconds >= 60 else f"{record.seconds:.1f} s"]
    reason = f"no GPU memory: {record.gpu_reason}"
    parts.append(reason if gpu is None else f"peak GPU memory {gpu / 2**20:,.0f} MiB")
    if record.peak_host_memory_bytes is not None:
        parts.append(f"peak RAM {record.peak_host_memory_bytes / 2**20:,.0f} MiB")
    return f"{out}: {', '.join(parts)}"
