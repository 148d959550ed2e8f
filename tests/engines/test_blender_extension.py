"""The extension for Blender: models look as on the standard tier and are exported unchanged."""

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from integrations.blender.build import build
from msb.asset import Asset
from msb.asset.texture import Sampler
from msb.engines.agreement import agreement
from msb.engines.blender import _python, blender_camera
from msb.engines.engine import NEAR
from msb.render import Frame
from msb.scenes import Camera
from tests.conftest import ROOT
from tests.engines.conftest import need
from tests.engines.test_engines import OFF_CENTRE
from tests.reference.golden import exported, golden_views
from tests.render.standard_scenes import BACKGROUND, scene
from tests.render.textured_scenes import textured_asset

FOLDER = ROOT / "integrations" / "blender"


def run_in_blender(models: list[tuple[Path, Camera]], folder: Path) -> list[dict[str, Any]]:
    """Return the extension's result for each model, with its rendered `frame` and the `saved` asset."""
    need("blender_cycles")
    jobs = [
        {
            "model": str(model),
            "camera": {**blender_camera(camera, np.eye(4)), "clip": [NEAR, 1000]},
            "image": str(folder / f"{number}.png"),
            "saved": str(folder / f"{number}.triasset"),
        }
        for number, (model, camera) in enumerate(models)
    ]
    program = Path(__file__).with_name("blender_extension.py")
    process = subprocess.run(
        [str(_python()), str(program), str(FOLDER), json.dumps(jobs)],
        stdout=subprocess.PIPE,
        encoding="utf-8",
        env={**os.environ, "MSB_PYTHON": sys.executable},
        timeout=600,
        check=True,
    )
    results: list[dict[str, Any]] = json.loads(process.stdout)
    for job, result in zip(jobs, results, strict=True):
        if "error" not in result:
            result["frame"], result["saved"] = read_frame(Path(job["image"])), msb.load(job["saved"])
    return results


def read_frame(path: Path) -> Frame:
    with Image.open(path) as image:
        rgba = np.asarray(image.convert("RGBA"), np.float32) / np.float32(255)
    alpha = np.float32(rgba[..., 3] > 0.5)
    image = np.where(alpha[..., None] > 0, rgba[..., :3], np.float32(BACKGROUND))
    return Frame(image=image, alpha=alpha, depth=np.zeros_like(alpha))


def draw(asset: Asset, camera: Camera) -> Frame:
    with msb.Renderer(asset) as renderer:
        return renderer.render(camera, BACKGROUND)


def without_mipmaps(asset: Asset) -> Asset:
    """Return `asset` without mip maps, because Cycles does not support them."""
    appearance = {**asset.manifest.appearance, "mipmaps": False}
    return Asset(replace(asset.manifest, appearance=appearance), asset.buffers)


@pytest.mark.slow
@pytest.mark.oracle
def test_models_look_as_on_the_standard_tier_and_are_exported_unchanged(tmp_path: Path) -> None:
    """The tested models: three methods, a baked model of the fourth method, and two noise textures times
    vertex colours.
    """
    pytest.importorskip("xatlas", reason="extra trial is not installed (xatlas)")
    views = [golden_views(method)[0] for method in ("two_dts", "triangle_splatting", "mesh_splatting")]
    models = [(view.folder / "checkpoint", view.camera) for view in views]
    assets = [exported(path) for path, _ in models]
    soup = golden_views("diffsoup")[0]
    baked = msb.bake(soup.folder / "checkpoint", geometry="kept", color="texture", texture=256, seconds=1)
    noise = {"sampler": Sampler(mipmaps=False), "sizes": ((48, 64, 3), (32, 32, 3)), "spread": 0.3}
    for name, asset, camera in (
        ("baked", without_mipmaps(baked.asset), soup.camera),
        ("textured", textured_asset(scene("large", 5), 5, tint="vertex", **noise), OFF_CENTRE),
    ):
        models.append((tmp_path / f"{name}.triasset", camera))
        assets.append(asset)
        msb.save(asset, models[-1][0])
    *results, rejected = run_in_blender([*models, (soup.folder / "checkpoint", soup.camera)], tmp_path)
    assert f"UNSUPPORTED_TIER: {soup.folder / 'checkpoint'}: diffsoup" in rejected["error"]
    for asset, (_, camera), result in zip(assets, models, results, strict=True):
        ours = draw(asset, camera)
        difference = agreement([result["frame"]], [ours])
        assert difference.interior_within_a_level > 0.999
        assert difference.covered_alike > 0.999
        assert result["transform"] == "Standard"
        counts = result["audit"]["counts"]
        assert result["marks"] == {name: counts[f"{name}_edges"] for name in ("boundary", "nonmanifold")}
        assert result["again"] == result["audit"]
        assert result["panel"][0] == result["audit"]["level"].upper()
        assert result["audit"]["sentence"] in " ".join(result["panel"])
        assert f"boundary edges: {counts['boundary_edges']:,}" in result["panel"]
        assert agreement([draw(result["saved"], camera)], [ours]).within_a_level == 1


def test_the_zip_can_be_installed_by_blender(tmp_path: Path) -> None:
    wheel = tmp_path / "some.whl"
    wheel.write_bytes(b"wheel")
    build(tmp_path / "built" / "extension.zip", [wheel], "linux-x64")
    with zipfile.ZipFile(tmp_path / "built" / "extension.zip") as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        names = set(archive.namelist())
    assert manifest["version"] == msb.__version__
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert manifest["platforms"] == ["linux-x64"]
    assert manifest["permissions"].keys() == {"files"}
    assert manifest["wheels"] == ["./wheels/some.whl"]
    assert {"__init__.py", "model.py", "worker.py", "wheels/some.whl"} < names
