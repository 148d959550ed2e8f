"""The files of a bake: a stage of USD has what it collides as."""

from pathlib import Path

import pytest

from msb.bake.collision import collision
from msb.bake.written import Part, write_all
from msb.meshes import read_mesh
from msb.meshes.assets import asset_from_mesh
from tests.bake.solids import ball, box, together


@pytest.mark.slow
def test_a_stage_has_each_part_that_it_collides_as_and_draws_none(tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr", reason="usd-core, of the extra usd, is not installed")
    from pxr import Usd, UsdGeom, UsdPhysics

    del pxr
    seen = together(box((1, 1, 1)), ball(8))
    shape = collision(seen, "hulls:2", seconds=1e-3)
    path = tmp_path / "a.usdc"
    part = Part("", asset_from_mesh(seen), {}, asset_from_mesh(shape.mesh), is_convex=True)
    write_all([part], [path])
    stage = Usd.Stage.Open(str(path))
    guides = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(guides) == shape.parts
    for prim in guides:
        assert UsdGeom.Imageable(prim).ComputePurpose() == "guide"
        assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "convexHull"
    assert len(read_mesh(path).faces) == len(seen.faces)
