"""Run the tests that need torch in a separate session: `python -m tests.with_torch`.

On Linux pip installs torch with gigabytes of CUDA libraries. The packages are therefore installed only once,
in the user's cache folder. Only this session uses them, because other sessions would become slow. For
example, hypothesis imports torch if it is installed.
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
    with tempfile.TemporaryDirectory() as site:
        if folder := packages():
            # Every Python process of the session runs this file, which adds the folder of torch.
            Path(site, "sitecustomize.py").write_text(f"import sys\nsys.path.append({str(folder)!r})\n")
        current = os.environ.get("PYTHONPATH")
        path = os.pathsep.join([site, *([current] if current else [])])
        # Use one thread per process, because there is already one process per core.
        variables = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        return subprocess.run(line, cwd=ROOT, env={**os.environ, **variables}, check=False).returncode


def packages() -> Path | None:
    """Return the folder of torch and lpips, after installing them if necessary, and print its size.

    Return None if the environment has both packages, or if they cannot be installed. The reason is printed.
    """
    if find_spec("torch") and find_spec("lpips"):
        return None
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    requirements = project["project"]["optional-dependencies"]["lpips"]
    # The name of the folder depends on the requirements, the Python version and the platform.
    text = "\n".join([*requirements, sys.implementation.cache_tag or "", sysconfig.get_platform()])
    cache = user_cache()
    assert cache is not None, "a user without a home folder has no place for torch"
    folder = cache / "meshsplatbench" / f"lpips-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    if not folder.is_dir():
        print("installing the extra lpips for tests (gigabytes if torch includes CUDA)", flush=True)
        if reason := install(requirements, folder):
            print(
                f"the extra lpips cannot be installed, so its tests are skipped ({reason})",
                file=sys.stderr,
            )
            return None
    size = sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir())
    print(f"the extra lpips for tests: {size / 1e9:.1f} GB in {folder}")
    return folder


def install(requirements: list[str], folder: Path) -> str | None:
    """Install packages into `folder` with pip, either completely or not at all.

    Return the reason of a failure.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="lpips-", dir=folder.parent) as temporary:
            target = Path(temporary) / "packages"
            pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
            # Temporary files are beside the target, because /tmp may be too small and on another file system.
            environment = {**os.environ, "TMPDIR": temporary}
            done = subprocess.run(
                [*pip, "--target", str(target), *requirements],
                env=environment, capture_output=True, text=True, errors="replace", timeout=SECONDS,
            )  # fmt: skip
            if done.returncode:
                errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR:")]
                return errors[-1] if errors else f"pip ended with {done.returncode}"
            target.rename(folder)
    except (OSError, subprocess.TimeoutExpired) as error:
        return None if folder.is_dir() else str(error)  # another session may have installed the packages
    return None


if __name__ == "__main__":
    sys.exit(main())
