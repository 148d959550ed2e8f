"""Fuzz readers: ``python -m fuzz ply glb --seconds 600`` or ``python -m fuzz --all --seconds 60``."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fuzz.targets import TARGETS
from msb.base.extras import install, is_installed

ROUND = 60
"""Seconds of one worker.

Code instrumented by atheris 3.0 leaks a few KB per execution. Workers are therefore replaced after a while.
"""
SLACK = 300
"""Extra seconds of a worker for imports, seeds, and the last input."""


@dataclass
class Outcome:
    """Outcome of one target.

    `coverage` counts the edges of all instrumented code, ours and that of libraries.
    """

    target: str
    executions: int = 0
    coverage: int = 0
    deaths: int = 0
    findings: int = 0


def fuzz(name: str, *, seconds: int, corpus: Path, findings: Path) -> Outcome:
    """Fuzz one target for `seconds` in successive processes, and print its line."""
    outcome = Outcome(name)
    (corpus / name).mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + seconds
    while (left := round(end - time.monotonic())) > 0:
        before = outcome.executions
        outcome.deaths += _run(outcome, min(left, ROUND), corpus / name, findings)
        if outcome.executions == before:
            break
    kept = findings / name
    outcome.findings = sum(path.suffix != ".txt" for path in kept.iterdir()) if kept.is_dir() else 0
    print(
        f"{name:26}{outcome.executions:>12,}{outcome.coverage:>8,}{outcome.deaths:>8}{outcome.findings:>10}",
        flush=True,
    )
    return outcome


def _run(outcome: Outcome, seconds: int, corpus: Path, findings: Path) -> bool:
    """Run one worker, add its results to `outcome`, and return whether it died."""
    command = [sys.executable, "-m", "fuzz.worker", outcome.target, str(seconds), str(corpus), str(findings)]
    with tempfile.TemporaryDirectory(prefix="msb-fuzz-", ignore_cleanup_errors=True) as scratch:
        environment = {**os.environ, "TMPDIR": scratch, "OPENBLAS_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                command, stderr=subprocess.PIPE, timeout=seconds + SLACK, env=environment, check=False
            )
            status, said = done.returncode, done.stderr.decode("utf-8", "replace")
        except subprocess.TimeoutExpired as late:
            status, said = 1, (late.stderr or b"").decode("utf-8", "replace")
    executions = [int(count) for count in re.findall(r"^#(\d+)\s", said, re.MULTILINE)]
    outcome.executions += max(executions, default=0)
    coverage = [int(count) for count in re.findall(r" cov: (\d+)", said)]
    outcome.coverage = max(outcome.coverage, *coverage, 0)
    if status:
        findings.mkdir(parents=True, exist_ok=True)
        with (findings / f"{outcome.target}.log").open("a", encoding="utf-8") as file:
            file.write(said[-20_000:])
    return status != 0


def main() -> int:
    """Run the requested targets; return 1 if there are findings."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="; ".join(TARGETS))
    parser.add_argument("--all", action="store_true", help="every target")
    parser.add_argument("--seconds", type=int, default=60, help="seconds per target (default 60)")
    parser.add_argument("--jobs", type=int, default=1, help="targets in parallel (default 1)")
    parser.add_argument(
        "--findings", type=Path, default=Path("fuzz-findings"), help="folder of failing inputs"
    )
    parser.add_argument("--corpus", type=Path, help="folder of inputs to reuse")
    options = parser.parse_args()
    unknown = [name for name in options.targets if name not in TARGETS]
    if unknown or not (options.targets or options.all):
        parser.error(f"unknown target {', '.join(unknown)}" if unknown else "name a target, or pass --all")
    if not is_installed("atheris"):
        parser.error(f"atheris is not installed: {install('fuzz')}")
    names = list(TARGETS) if options.all else options.targets
    print(f"{'target':26}{'executions':>12}{'edges':>8}{'deaths':>8}{'findings':>10}")
    with tempfile.TemporaryDirectory(prefix="msb-fuzz-corpus-") as temporary:
        corpus = (options.corpus or Path(temporary)).absolute()
        one = partial(fuzz, seconds=options.seconds, corpus=corpus, findings=options.findings.absolute())
        with ThreadPoolExecutor(options.jobs) as pool:
            outcomes = list(pool.map(one, names))
    total = sum(outcome.executions for outcome in outcomes)
    found = sum(outcome.findings for outcome in outcomes)
    print(f"{total:,} executions, {found} findings{f' in {options.findings}' if found else ''}")
    return min(found, 1)


if __name__ == "__main__":
    sys.exit(main())
