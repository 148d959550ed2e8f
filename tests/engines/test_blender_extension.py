"""The extension for Blender: models look there as on the standard tier, and come back as they were."""

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


def in_blender(jobs: list[tuple[Path, Camera]], folder: Path) -> list[dict[str, Any]]:
    """Return what the extension found of models, each with the `frame` it drew and the asset it `saved`."""
    need("blender_cycles")
    python = _python()
    assert python is not None
    asked = [
        {
            "model": str(model),
            "camera": {**blender_camera(camera, np.eye(4)), "clip": [NEAR, 1000]},
            "picture": str(folder / f"{number}.png"),
            "saved": str(folder / f"{number}.triasset"),
        }
        for number, (model, camera) in enumerate(jobs)
    ]
    program = Path(__file__).with_name("blender_extension.py")
    done = subprocess.run(
        [python, str(program), str(FOLDER), json.dumps(asked)],
        stdout=subprocess.PIPE,
        encoding="utf-8",
        env={**os.environ, "MSB_PYTHON": sys.executable},
        timeout=600,
        check=True,
    )
    found: list[dict[str, Any]] = json.loads(done.stdout)
    for job, one in zip(asked, found, strict=True):
        if "error" not in one:
            one["frame"], one["saved"] = frame_of(Path(job["picture"])), msb.load(job["saved"])
    return found


def frame_of(path: Path) -> Frame:
    with Image.open(path) as image:
        rgba = np.asarray(image.convert("RGBA"), np.float32) / np.float32(255)
    alpha = np.float32(rgba[..., 3] > 0.5)
    image = np.where(alpha[..., None] > 0, rgba[..., :3], np.float32(BACKGROUND))
    return Frame(image=image, alpha=alpha, depth=np.zeros_like(alpha))


def ours(asset: Asset, camera: Camera) -> Frame:
    with msb.Renderer(asset) as renderer:
        return renderer.render(camera, BACKGROUND)


def unmipped(asset: Asset) -> Asset:
    """Return `asset` without mip maps, which Cycles has none of."""
    appearance = {**asset.manifest.appearance, "mipmaps": False}
    return Asset(replace(asset.manifest, appearance=appearance), asset.buffers)


@pytest.mark.slow
@pytest.mark.oracle
def test_models_look_as_on_the_standard_tier_and_come_back(tmp_path: Path) -> None:
    """Three methods, what a bake made of the fourth, and noise in two textures times colours."""
    pytest.importorskip("xatlas", reason="extra trial is not installed (xatlas)")
    views = [golden_views(method)[0] for method in ("two_dts", "triangle_splatting", "mesh_splatting")]
    jobs = [(view.folder / "checkpoint", view.camera) for view in views]
    assets = [exported(path) for path, _ in jobs]
    soup = golden_views("diffsoup")[0]
    baked = msb.bake(soup.folder / "checkpoint", geometry="kept", color="texture", texture=256, seconds=1)
    noise = {"sampler": Sampler(mipmaps=False), "sizes": ((48, 64, 3), (32, 32, 3)), "spread": 0.3}
    for name, asset, camera in (
        ("baked", unmipped(baked.asset), soup.camera),
        ("textured", textured_asset(scene("large", 5), 5, tint="vertex", **noise), OFF_CENTRE),
    ):
        jobs.append((tmp_path / f"{name}.triasset", camera))
        assets.append(asset)
        msb.save(asset, jobs[-1][0])
    *found, refused = in_blender([*jobs, (soup.folder / "checkpoint", soup.camera)], tmp_path)
    assert f"UNSUPPORTED_TIER: {soup.folder / 'checkpoint'}: diffsoup" in refused["error"]
    for asset, (_, camera), one in zip(assets, jobs, found, strict=True):
        own = ours(asset, camera)
        drawn = agreement([one["frame"]], [own])
        assert drawn.interior_within_a_level > 0.999
        assert drawn.covered_alike > 0.999
        assert one["transform"] == "Standard"
        counts = one["audit"]["counts"]
        assert one["marks"] == {name: counts[f"{name}_edges"] for name in ("boundary", "nonmanifold")}
        assert one["again"] == one["audit"]
        assert one["panel"][0] == one["audit"]["level"].upper()
        assert one["audit"]["sentence"] in " ".join(one["panel"])
        assert f"boundary edges: {counts['boundary_edges']:,}" in one["panel"]
        assert agreement([ours(one["saved"], camera)], [own]).within_a_level == 1


def test_the_zip_is_what_blender_installs(tmp_path: Path) -> None:
    wheel = tmp_path / "some.whl"
    wheel.write_bytes(b"wheel")
    build(tmp_path / "made" / "extension.zip", [wheel], "linux-x64")
    with zipfile.ZipFile(tmp_path / "made" / "extension.zip") as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        names = set(archive.namelist())
    assert manifest["version"] == msb.__version__
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert manifest["platforms"] == ["linux-x64"]
    assert manifest["permissions"].keys() == {"files"}
    assert manifest["wheels"] == ["./wheels/some.whl"]
    assert {"__init__.py", "model.py", "worker.py", "wheels/some.whl"} < names
