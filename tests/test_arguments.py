"""Invalid arguments of public functions raise our errors. Numbers of NumPy are accepted."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.meshes import Mesh
from msb.repair import plan
from msb.scenes import write_cameras
from tests.conftest import ROOT

VIEW: dict[str, Any] = {"up": (0, 1, 0), "width": 16, "height": 12, "fov_y": 0.6}
MODEL = ROOT / "tests" / "tiny" / "models" / "walled" / "two_dts"
CAMERA = msb.Camera.look_at((0.5, 0.5, 3), (0.5, 0.5, 0.5), **VIEW)


@pytest.fixture(scope="module")
def asset(demo_asset: Path) -> msb.Asset:
    return msb.open(demo_asset)


WRONG: dict[str, tuple[Callable[[msb.Asset], Any], str]] = {
    "steps": (lambda a: msb.repair(a, [["cut"]]), "USAGE"),
    "half a face": (lambda a: msb.repair(a, debris_faces=1.5), "USAGE"),
    "true edges": (lambda a: msb.repair(a, close_edges=np.True_), "USAGE"),
    "NaN weights": (lambda a: msb.repair(a, "drop", weights=weights(a, np.nan)), "USAGE"),
    "negative weights": (lambda a: msb.repair(a, "drop", weights=weights(a, -1)), "USAGE"),
    "a background": (lambda a: msb.render(a, CAMERA, background=object()), "USAGE"),
    "export settings": (lambda _: msb.export(MODEL, settings=3), "USAGE"),
    "export method": (lambda _: msb.export(MODEL, method=3), "USAGE"),
    "export config": (lambda _: msb.export(MODEL, config=3), "USAGE"),
    "lists": (lambda _: Mesh([[0, 0, 0]], [[0, 0, 0]]), "MESH_ARRAY"),
    "swapped": (lambda _: write_cameras("c.json", [CAMERA]), "USAGE"),
    "no path": (lambda _: write_cameras([CAMERA], [CAMERA]), "USAGE"),
    "far": (lambda _: msb.Camera.look_at((1e30, 0, 0), (0, 0, 0), **VIEW), "CAMERA_PATH"),
}


def weights(asset: msb.Asset, value: float) -> np.ndarray:
    return np.full(asset.manifest.face_count, value)


@pytest.mark.parametrize(("call", "code"), WRONG.values(), ids=WRONG)
def test_invalid_arguments_raise_our_errors(
    asset: msb.Asset, call: Callable[[msb.Asset], Any], code: str
) -> None:
    with pytest.raises(msb.MsbError) as caught:
        call(asset)
    assert caught.value.code == code


def test_numbers_of_numpy_are_accepted() -> None:
    options = plan.Options(debris_faces=np.int64(3), pair_color=np.float32(0.5)).check()
    assert (options.debris_faces, options.pair_color) == (3, 0.5)
    assert type(options.debris_faces) is int
