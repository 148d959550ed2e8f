"""Errors of the Python API about extras that are not installed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from msb.base.extras import install, need_extra
from msb.errors import UsageError
from tests.conftest import ROOT

CALLS = {
    "ssim": ("bench", "metrics.ssim(image, image)"),
    "read EXR": ("bench", "metrics.read_image('a.exr')"),
    "write EXR": ("bench", "images.write_image(Path('b.exr'), image, 'exr')"),
    "results": ("bench", "folder.lock_results(Path('r')).__enter__()"),
    "track": ("bench", "track.track(['true'])"),
    "page": ("bench", "pages._make_environment()"),
    "figure": ("bench", "figures._make_figure('n', 't', 'c', print).svg"),
    "film": ("video", "images.write_film(Path('f.mp4'), [image], 24)"),
    "lpips": ("lpips", "metrics.lpips_vgg(image, image, vgg_weights='vgg.pth')"),
    "cluster": ("distributed", "pool.DaskWorkers('tcp://127.0.0.1:1')"),
    "window": ("view", "gl.GlProbe.start()"),
    "topology figure": ("view", "figure.write_figure(None, Path('t.png'))"),
}
"""Name of a case -> the required extra and the call."""
DRIVER = """
import json, sys
from pathlib import Path
calls, absent = json.load(sys.stdin)
sys.modules.update(dict.fromkeys(absent))
import numpy as np
from msb import metrics
from msb.bench import folder, pool, track
from msb.errors import MsbError
from msb.render import images
from msb.report import figures, pages
from msb_viewers import figure, gl
image, errors = np.zeros((8, 8, 3), np.float32), {}
Path("a.exr").touch()
for name, call in calls.items():
    try:
        eval(call)
    except MsbError as error:
        errors[name] = [error.code, error.exit_status, str(error)]
print(json.dumps([errors, sorted(path.name for path in Path().iterdir())]))
"""
ABSENT = ("skimage", "matplotlib", "jinja2", "OpenEXR", "psutil", "filelock", "av")
ABSENT += ("torch", "lpips", "distributed", "pyvista", "vtkmodules")


@pytest.mark.slow
def test_the_api_names_the_extra_and_leaves_nothing_behind(tmp_path: Path) -> None:
    for capability in ("msb.bench", "msb.report", "msb_viewers"):
        pytest.importorskip(capability)
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        input=json.dumps([{name: call for name, (_, call) in CALLS.items()}, ABSENT]),
        capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False,
        env={"PYTHONPATH": f"{ROOT}:{ROOT / 'viewers'}"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    errors, left = json.loads(done.stdout)
    for name, (extra, _) in CALLS.items():
        code, status, text = errors[name]
        assert (code, status) == ("EXTRA_MISSING", 2)
        assert install(extra) in text
    assert left == ["a.exr"]


def test_only_missing_modules_are_reported() -> None:
    need_extra("bench", "numpy", what="this")
    with pytest.raises(UsageError, match=r"EXTRA_MISSING: .*no_such.*") as info:
        need_extra("bench", "numpy", "no_such", what="this", instead="that needs none")
    assert info.value.exit_status == 2
