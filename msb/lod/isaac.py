"""The folder for Isaac Sim: a USD prop in the layout and with the data of NVIDIA's SimReady profiles.

Requirements are named by their numbers, such as NP.005, of the package simready-foundation-tier-core.
"""

from __future__ import annotations

import datetime
import io
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.lod.quality import draw
from msb.meshes.assets import asset_from_mesh, fit_to_format
from msb.meshes.formats import Style
from msb.meshes.image_files import name_images
from msb.meshes.mesh import Mesh
from msb.meshes.normals import with_smooth_normals
from msb.meshes.usd_looks import encode_used_images
from msb.meshes.usd_write import build_stage
from msb.scenes.around import make_turntable

if TYPE_CHECKING:
    from msb.lod.packages import Body

# NP.005: the asset lies in a folder of the package whose name is free.
_FOLDER = "simready_usd"
# Width and height of the thumbnail (SR.002), and the direction it shows the asset from.
_THUMBNAIL, _ELEVATION = 256, 25.0
# Coefficient of friction of the colliders, the default of PhysX.
_FRICTION = 0.5
# A label "chair:Q15026" has a Wikidata code; without one, the code of "physical object" is used.
_LABEL = re.compile(r"(.*?)(?::(Q[0-9]+))?")
_QCODE = "Q223557"


def list_isaac_files(body: Body) -> dict[str, bytes]:
    """Return the files of the folder by their relative paths; the first one is the asset."""
    from pxr import Gf, Usd, UsdGeom

    # The file and the folder of the package have one name, as NP.005 requires.
    file = f"{body.name}.usda"
    mesh = with_smooth_normals(fit_to_format(replace(body.mesh, up=None, frame=None), ".usda"))
    style = Style(stem=body.name, collision=tuple(body.parts), is_convex=body.is_convex, is_lit=True)
    layer = build_stage(mesh, name_images(mesh, style), style)
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)  # UN.006
    _add_physics(stage, body)
    match = _LABEL.fullmatch(body.label)
    assert match is not None
    label, code = match[1] or body.name, match[2] or _QCODE
    root = stage.GetDefaultPrim()
    _add_label(root, "class", label)
    _add_label(root, "wikidata_qcode", code)
    for prim in stage.Traverse():
        if prim.GetTypeName() == "Material":
            _add_label(prim, "material", "plastic")  # SL.MAT.001
    # DISP.001: programs without materials show a grey asset. Vertex colours are the colour already.
    visible = UsdGeom.Mesh.Get(stage, root.GetPath().AppendChild("mesh"))
    if not visible.GetDisplayColorPrimvar().HasValue():
        visible.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set([Gf.Vec3f(0.5)])
    # SR.001 and SR.004: all fields are in the layer.
    extents = np.ptp(mesh.vertices[np.unique(mesh.faces)], axis=0).astype(float).tolist()
    identity = {
        "asset_name": body.name,
        "asset_type": "prop",
        "source_file": body.source,
        "usd_date_generated": datetime.datetime.now(datetime.UTC).date().isoformat(),
    }
    layer.customLayerData = {
        **identity,
        "SimReady_Metadata": {
            **identity,
            "author": "unknown",
            "asset_license": "unknown",
            "category": label,
            "qcode": code,
            "rigid_body_count": 1,
            "asset_extents": Gf.Vec3f(*extents),
            "mass": float(body.mass),
        },
    }
    files = {f"{_FOLDER}/{file}": layer.ExportToString().encode()}
    files |= {f"{_FOLDER}/{name}": data for name, data in encode_used_images(mesh, style).items()}
    files[f"{_FOLDER}/.thumbs/256x256/{file}.png"] = _draw_thumbnail(body.shown)
    return files


def _add_physics(stage: Any, body: Body) -> None:
    """Make the root a rigid body with mass and inertia (RB.001), and the colliders ready for simulators."""
    from pxr import Gf, UsdPhysics, UsdShade

    root = stage.GetDefaultPrim()
    UsdPhysics.RigidBodyAPI.Apply(root)
    mass = UsdPhysics.MassAPI.Apply(root)
    mass.CreateMassAttr(float(body.mass))
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*map(float, body.center)))
    # The principal axes are the columns of a rotation; its determinant must be positive.
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*map(float, moments)))
    # USD stores matrices for row vectors, so the rows are the axes.
    rotation = Gf.Matrix3d(*map(float, axes.T.reshape(-1))).ExtractRotation().GetQuat()
    mass.CreatePrincipalAxesAttr(Gf.Quatf(rotation))
    # PMT.001, NEWTON.COL.001, MUJOCO.COL.001: colliders have a material and the schemas of the engines.
    material = UsdShade.Material.Define(stage, root.GetPath().AppendPath("materials/physics"))
    friction = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    friction.CreateStaticFrictionAttr(_FRICTION)
    friction.CreateDynamicFrictionAttr(_FRICTION)
    for prim in [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]:
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, materialPurpose="physics")
        for schema in ("NewtonCollisionAPI", "NewtonMeshCollisionAPI", "MjcCollisionAPI"):
            prim.AddAppliedSchema(schema)


def _add_label(prim: Any, taxonomy: str, label: str) -> None:
    """Give a prim a semantic label."""
    from pxr import UsdSemantics

    api = UsdSemantics.LabelsAPI.Apply(prim, taxonomy)
    api.CreateLabelsAttr([label])


def _draw_thumbnail(mesh: Mesh) -> bytes:
    """Return a PNG of the asset."""
    from PIL import Image

    size = (_THUMBNAIL, _THUMBNAIL)
    cameras = make_turntable(asset_from_mesh(mesh), 8, *size, up="+z", elevation=_ELEVATION)[5:6]
    image = draw(mesh, cameras)[0]
    file = io.BytesIO()
    Image.fromarray((255 * image.clip(0, 1) + 0.5).astype(np.uint8)).save(file, "png")
    return file.getvalue()
