"""One target in one process: ``python -m fuzz.worker TARGET SECONDS CORPUS FINDINGS``, started by `fuzz`."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import atheris

INPUT_SECONDS = 5
"""Limit of the wall time of an input. It allows for a busy machine and instrumented code."""
INSTRUMENTED = ["msb", "tomllib", "yaml", "zipfile"]
"""Instrumented packages, which guide the search: our packages, and Python parsers whose errors may reach the
user.
"""


class Findings:
    """Failing inputs of a target with their failures. There is one input per place in the code."""

    def __init__(self, folder: Path, target: str) -> None:
        self.folder = folder / target
        self.current = b""
        self.seen: set[str] = set()

    def keep(self, place: str, text: str) -> None:
        """Write the current input and `text`, unless there is already a finding at this `place`."""
        if place in self.seen:
            return
        self.seen.add(place)
        self.folder.mkdir(parents=True, exist_ok=True)
        name = hashlib.sha256(place.encode()).hexdigest()[:12]
        (self.folder / name).write_bytes(self.current)
        (self.folder / f"{name}.txt").write_text(text)

    def raised(self, error: BaseException) -> None:
        """Record an exception. Exceptions of the same type from the same line are one finding."""
        frames = traceback.extract_tb(error.__traceback__)
        last = next(
            (frame for frame in reversed(frames) if f"{os.sep}msb{os.sep}" in frame.filename), frames[-1]
        )
        self.keep(
            f"{type(error).__name__} {last.filename}:{last.lineno}",
            "".join(traceback.format_exception(error)),
        )

    def forbidden(self, text: str) -> None:
        """Record an action that the guard stopped."""
        self.keep(text.partition("\n")[0], text)


def main(name: str, seconds: int, corpus: Path, findings: Path) -> None:
    """Fuzz the target `name`. New inputs go to the folder `corpus`, failing inputs to `findings`."""
    with atheris.instrument_imports(include=INSTRUMENTED):
        from fuzz.guard import Guard, limit_memory
        from fuzz.targets import TARGETS

        target = TARGETS[name]
        scratch = Path(tempfile.mkdtemp(prefix="msb-fuzz-"))
        feed = target.at(scratch)
        found = Findings(findings, name)

        guard = Guard(scratch, found.forbidden)

        def one(data: bytes, within: contextlib.AbstractContextManager[None] = guard) -> None:
            found.current = data
            start = time.process_time()
            try:
                with within:
                    feed(data)
            except Exception as error:
                found.raised(error)
            if (spent := time.process_time() - start) > INPUT_SECONDS:
                found.keep(f"time {name}", f"{spent:.1f} s of CPU time\n")

        # Import and instrument modules now that are otherwise imported on first use.
        for seed in target.small_seeds():
            one(seed, contextlib.nullcontext())
            (corpus / hashlib.sha256(seed).hexdigest()[:16]).write_bytes(seed)
    warnings.simplefilter("error")  # a user would see the warning instead of our error line
    limit_memory()
    artifacts = findings / name / "libfuzzer-"
    artifacts.parent.mkdir(parents=True, exist_ok=True)
    options = [
        f"-max_total_time={seconds}",
        f"-timeout={INPUT_SECONDS * 4}",
        "-rss_limit_mb=2048",
        "-max_len=65536",
        f"-artifact_prefix={artifacts}",
        "-print_final_stats=1",
    ]
    atheris.Setup([sys.argv[0], *options, str(corpus)], one, enable_python_coverage=True)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), Path(sys.argv[4]))
