"""Run the tests that need torch, in a session of their own: `python -m tests.with_torch`.

With torch, as pip resolves it, come gigabytes of CUDA's libraries on Linux. So the packages are kept in the
user's cache folder, once for all checkouts, and stand behind the environment's own for this session alone:
whatever else imports torch where it can, as hypothesis' search for constants does, is slow with it.
"""

import hashlib
import os
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
from importlib.util import find_spec
from pathlib import Path

from msb.cl.loader import user_cache

ROOT = Path(__file__).parent.parent
FOLDERS = ("tests/metrics", "tests/adapters", "tests/training")
SECONDS = 1800


def main() -> int:
    """Run the tests marked torch, and return pytest's status."""
    line = [sys.executable, "-m", "pytest", "-n", "auto", "--dist", "worksteal", "-m", "torch", *FOLDERS]
    with tempfile.TemporaryDirectory() as made:
        if folder := packages():
            # Python reads this at every start, of commands that tests run as well, and puts the folder last.
            Path(made, "sitecustomize.py").write_text(f"import sys\nsys.path.append({str(folder)!r})\n")
        own = os.environ.get("PYTHONPATH")
        path = os.pathsep.join([made, *([own] if own else [])])
        # A process a core: threads of several processes would wait for each other.
        own_core = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        return subprocess.run(line, cwd=ROOT, env={**os.environ, **own_core}, check=False).returncode


def packages() -> Path | None:
    """Return the folder of torch and lpips; say in a line what they weigh or why they are not there.

    None stands for an environment that has both, and for one that cannot.
    """
    if find_spec("torch") and find_spec("lpips"):
        return None
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = project["project"]["optional-dependencies"]["lpips"]
    # One for these requirements, this Python and this platform.
    text = "\n".join([*wanted, sys.implementation.cache_tag or "", sysconfig.get_platform()])
    cache = user_cache()
    assert cache is not None, "a user without a home has no place for torch"
    folder = cache / "meshsplatbench" / f"lpips-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    if not folder.is_dir():
        print("installing the extra lpips, for tests: gigabytes where torch brings CUDA along", flush=True)
        if reason := install(wanted, folder):
            print(
                f"the extra lpips cannot be installed here: its tests will be skipped ({reason})",
                file=sys.stderr,
            )
            return None
    size = sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir())
    print(f"the extra lpips, for tests: {size / 1e9:.1f} GB, kept in {folder}")
    return folder


def install(wanted: list[str], folder: Path) -> str | None:
    """Have pip install into `folder`, whole or not at all; return the reason if it cannot."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="lpips-", dir=folder.parent) as made:
            target = Path(made) / "packages"
            pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
            # Beside the target: /tmp may be small, and from there everything would be copied.
            environment = {**os.environ, "TMPDIR": made}
            done = subprocess.run(
                [*pip, "--target", str(target), *wanted],
                env=environment, capture_output=True, text=True, errors="replace", timeout=SECONDS,
            )  # fmt: skip
            if done.returncode:
                errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR:")]
                return errors[-1] if errors else f"pip ended with {done.returncode}"
            target.rename(folder)
    except (OSError, subprocess.TimeoutExpired) as error:
        return None if folder.is_dir() else str(error)  # another make may have been first
    return None


if __name__ == "__main__":
    sys.exit(main())
