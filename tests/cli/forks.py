"""Run `msb` in processes that are forked from a server.

The server has already imported `msb`. This saves 90 % of the time.
"""

import atexit
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from tests.conftest import ROOT

SECONDS = 600
"""Time limit of a command."""
STARTS = ("PYTHON", "LC_", "LANG", "LD_")
"""Prefixes of variables that Python reads at its start. With such a variable, forking is not possible."""
IMPORTED = [
    "msb.adapters.exporter",
    "msb.adapters.tensors",
    "msb.bench.profile",
    "msb.bench.run",
    "msb.meshes.assets",
    "msb.metrics",
    "msb.reference",
    "msb.render.dedicated",
    "msb.render.images",
    "msb.render.standard.renderer",
    "msb.report.build",
    "msb.scenes.datasets",
    "msb.topology.explain",
    "jinja2",
    "matplotlib.backends.backend_agg",
    "matplotlib.figure",
    "PIL.PngImagePlugin",
    "platformdirs",
    "pytools.persistent_dict",
    "rich._emoji_codes",
    "rich.progress",
    "scipy.sparse.csgraph",
    "scipy.spatial",
    "skimage.metrics",
    "sqlite3",
    "yaml",
]
"""Modules that commands import. pyopencl is omitted, because its loader must start in the child."""
SERVER = """
import contextlib, functools, gc, json, os, pathlib, pkgutil, signal, sys
from importlib import import_module
import typer.main
import msb.cli
from msb.cli.commands import BUILT_IN
from tests.validator import WRITTEN, keep_written
seconds, *imported = sys.argv[1:]
imported += [module.name for module in pkgutil.iter_modules(msb.cli.__path__, "msb.cli.")]
imported += [place.module for places in BUILT_IN.values() for place in places.values()]
for name in imported:
    with contextlib.suppress(ModuleNotFoundError):  # a removed capability or a missing extra
        import_module(name)
# Typer builds the same objects for the same commands, so cache them.
typer.main.get_command = functools.cache(typer.main.get_command)
typer.main.get_command(import_module("msb.cli.app").app)
if WRITTEN in os.environ:
    keep_written(pathlib.Path(os.environ[WRITTEN]))
gc.freeze()  # otherwise garbage collection in a child would copy all of its memory
for line in sys.stdin:
    wanted = json.loads(line)
    if not (child := os.fork()):
        break
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
else:
    sys.exit()
for number, (name, how) in enumerate(
    ((os.devnull, os.O_RDONLY), (wanted["out"], os.O_WRONLY), (wanted["err"], os.O_WRONLY))
):
    os.dup2(os.open(name, how), number)
os.environ.clear()
os.environ.update(wanted["env"])
os.chdir(wanted["cwd"])
signal.alarm(int(seconds))
sys.argv = ["msb", *wanted["args"]]
msb.cli.main()
"""


@cache
def _server() -> tuple[subprocess.Popen[str], Path]:
    """Start the server. Return it, and a new folder for the output of its children."""
    folder = tempfile.TemporaryDirectory(prefix="msb-forks-", ignore_cleanup_errors=True)
    process = subprocess.Popen(
        [sys.executable, "-c", SERVER, str(SECONDS), *IMPORTED],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        # Threads of a linear algebra library would not exist in a forked child.
        env={**os.environ, "PYTHONPATH": _PATH, "OPENBLAS_NUM_THREADS": "1"},
    )
    atexit.register(folder.cleanup)
    atexit.register(process.communicate)  # the server exits at the end of its input
    return process, Path(folder.name)


_PATH = os.pathsep.join(filter(None, [str(ROOT), str(ROOT / "viewers"), os.environ.get("PYTHONPATH")]))


def run_msb(args: list[str], cwd: Path, env: Mapping[str, str | None]) -> subprocess.CompletedProcess[bytes]:
    """Run `msb` in `cwd` with the variables of this process, changed by `env`.

    The value None removes a variable.
    """
    merged = {**os.environ, "PYTHONPATH": _PATH, **env}
    wanted = {name: value for name, value in merged.items() if value is not None}
    if not hasattr(os, "fork") or any(name.startswith(STARTS) for name in env):
        return subprocess.run(
            [sys.executable, "-m", "msb", *args],
            capture_output=True, cwd=cwd, env=wanted, timeout=SECONDS, check=False,
        )  # fmt: skip
    process, folder = _server()
    out, err = folder / "out", folder / "err"
    for file in (out, err):
        file.write_bytes(b"")
    line = {"args": args, "cwd": str(cwd), "env": wanted, "out": str(out), "err": str(err)}
    process.stdin.write(json.dumps(line) + "\n")
    process.stdin.flush()
    status = int(process.stdout.readline())
    return subprocess.CompletedProcess(args, status, out.read_bytes(), err.read_bytes())
