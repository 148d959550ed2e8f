"""Meshes written as USD, by usd-core: a stage with one mesh, its unlit look, and what it collides as."""

from __future__ import annotations

import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import LINEAR, srgb_to_linear
from msb.asset.writer import stored_member
from msb.base.extras import need_extra
from msb.meshes.formats import Style
from msb.meshes.image_files import image_names, images_of
from msb.meshes.mesh import Mesh
from msb.meshes.writing import as_float32

Kind = Literal["usda", "usdc", "usdz"]


def write(kind: Kind, mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write text, binary, or a package with its textures: a stage with y up, in metres.

    Its default prim holds the mesh, its materials and its collision. The look is unlit: the colours are what
    UsdPreviewSurface shines with. Colours of vertices and faces are `displayColor`, in linear light; beside a
    texture there are none, for nothing multiplies the two. Shapes to collide with are guides, which are not
    drawn.
    """
    need_extra("usd", "pxr", what="a file of USD")
    has_images = kind == "usdz" or style.stem is not None
    layer = _stage(mesh, image_names(mesh, style) if has_images else [], style)
    if kind == "usda":
        stream.write(layer.ExportToString().encode())
        return
    with TemporaryDirectory(prefix="msb-usd-") as folder:
        path = Path(folder) / "asset.usdc"
        layer.Export(str(path))
        content = path.read_bytes()
    if kind == "usdc":
        stream.write(content)
        return
    # What a package is of is its first member.
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {"asset.usdc": content, **images_of(mesh, style)}.items():
            with stored_member(archive, stream, name, len(data)) as member:
                member.write(data)


def _stage(mesh: Mesh, images: list[str], style: Style) -> Any:
    """Return the layer of a whole stage."""
    from pxr import Kind as Kinds
    from pxr import Sdf, Usd, UsdGeom, UsdPhysics

    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/asset")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kinds.Tokens.component)
    _paint(_defined(stage, "/asset/mesh", mesh), mesh, images)
    for number, part in enumerate(style.collision):
        made = _defined(stage, f"/asset/collision_{number}", part)
        made.CreatePurposeAttr(UsdGeom.Tokens.guide)
        UsdPhysics.CollisionAPI.Apply(made.GetPrim())
        # One that is not convex is used as it is, which simulators do for what does not move.
        convex = UsdPhysics.Tokens.convexHull if style.is_convex else UsdPhysics.Tokens.none
        UsdPhysics.MeshCollisionAPI.Apply(made.GetPrim()).CreateApproximationAttr(convex)
    return layer


def _defined(stage: Any, path: str, mesh: Mesh) -> Any:
    """Return a new prim with the triangles of `mesh`."""
    from pxr import UsdGeom, Vt

    made = UsdGeom.Mesh.Define(stage, path)
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(as_float32(mesh.vertices, "USD"))))
    made.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    made.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.astype(np.int32).reshape(-1)))
    made.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    # Readers want normals where a surface is not subdivided; those of faces claim nothing.
    made.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(_normals(mesh)))
    made.SetNormalsInterpolation(UsdGeom.Tokens.uniform)
    made.CreateDoubleSidedAttr(True)
    if len(mesh.vertices):
        made.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(made.GetPointsAttr().Get()))
    return made


def _normals(mesh: Mesh) -> NDArray[np.float32]:
    """Return the unit normals (F, 3) of the faces, y where a face has none."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    long = np.linalg.norm(across, axis=1, keepdims=True)
    return np.where(long > 0, across / np.where(long > 0, long, 1), (0, 1, 0)).astype(np.float32)


def _paint(made: Any, mesh: Mesh, images: list[str]) -> None:
    """Give a prim its colours or textures, and the materials that show them."""
    from pxr import Sdf, UsdGeom, UsdShade, Vt

    stage, primvars = made.GetPrim().GetStage(), UsdGeom.PrimvarsAPI(made)
    if not images:
        colors = mesh.face_colors if mesh.vertex_colors is None else mesh.vertex_colors
        if colors is None:
            return
        light = LINEAR[colors[:, :3]] if colors.dtype == np.uint8 else srgb_to_linear(colors[:, :3])
        light = np.ascontiguousarray(light, np.float32)
        of = UsdGeom.Tokens.uniform if mesh.vertex_colors is None else UsdGeom.Tokens.vertex
        _set(made.CreateDisplayColorPrimvar(of), light, Vt.Vec3fArray)
        surface = _unlit(stage, "/asset/materials/colors")
        name = Sdf.ValueTypeNames.String, "displayColor"
        reader = _shader(stage, "/asset/materials/colors/read", "UsdPrimvarReader_float3", varname=name)
        shown = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
        surface.GetInput("emissiveColor").ConnectToSource(shown)
        _bind(made, "/asset/materials/colors")
        return
    uvs = mesh.vertex_uvs if mesh.corner_uvs is None else mesh.corner_uvs
    assert uvs is not None
    of = UsdGeom.Tokens.vertex if mesh.corner_uvs is None else UsdGeom.Tokens.faceVarying
    upward = np.column_stack((uvs[:, 0], 1 - uvs[:, 1])).astype(np.float32)
    _set(primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, of), upward, Vt.Vec2fArray)
    for number, image in enumerate(images):
        _texture(stage, f"/asset/materials/texture_{number}", image, mesh)
        if mesh.face_textures is None:
            _bind(made, f"/asset/materials/texture_{number}")
            continue
        own = np.flatnonzero(mesh.face_textures == number).astype(np.int32)
        part = UsdGeom.Subset.CreateGeomSubset(
            made,
            f"texture_{number}",
            UsdGeom.Tokens.face,
            Vt.IntArray.FromNumpy(own),
            UsdShade.Tokens.materialBind,
            UsdGeom.Tokens.partition,
        )
        _bind(part, f"/asset/materials/texture_{number}")


def _set(primvar: Any, values: NDArray[np.float32], kind: Any) -> None:
    """Set a primvar; values that are repeated are stored once."""
    from pxr import Vt

    bits = np.ascontiguousarray(values).view(np.uint32)
    _, first, number = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    if len(first) < len(values):
        primvar.SetIndices(Vt.IntArray.FromNumpy(number.reshape(-1).astype(np.int32)))
        values = values[first]
    primvar.Set(kind.FromNumpy(np.ascontiguousarray(values)))


def _texture(stage: Any, path: str, image: str, mesh: Mesh) -> None:
    """Define the material of a texture."""
    from pxr import Sdf

    surface = _unlit(stage, path)
    kinds = Sdf.ValueTypeNames
    reader = _shader(stage, f"{path}/read", "UsdPrimvarReader_float2", varname=(kinds.String, "st"))
    texture = _shader(
        stage,
        f"{path}/texture",
        "UsdUVTexture",
        file=(kinds.Asset, Sdf.AssetPath(f"./{image}")),
        sourceColorSpace=(kinds.Token, "sRGB"),
        wrapS=(kinds.Token, mesh.sampler.wrap_u),
        wrapT=(kinds.Token, mesh.sampler.wrap_v),
    )
    at = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(at)
    shown = texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.GetInput("emissiveColor").ConnectToSource(shown)
    if mesh.sampler.alpha_cutoff is not None:
        alpha = texture.CreateOutput("a", Sdf.ValueTypeNames.Float)
        surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).ConnectToSource(alpha)
        surface.CreateInput("opacityThreshold", Sdf.ValueTypeNames.Float).Set(mesh.sampler.alpha_cutoff)


def _shader(stage: Any, path: str, name: str, **inputs: tuple[Any, Any]) -> Any:
    """Return a new shader; `inputs` are the type and value of each."""
    from pxr import UsdShade

    made = UsdShade.Shader.Define(stage, path)
    made.CreateIdAttr(name)
    for key, (kind, value) in inputs.items():
        made.CreateInput(key, kind).Set(value)
    return made


def _unlit(stage: Any, path: str) -> Any:
    """Return the surface of a new material, which reflects nothing."""
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, "/asset/materials")
    material = UsdShade.Material.Define(stage, path)
    surface = _shader(
        stage,
        f"{path}/surface",
        "UsdPreviewSurface",
        diffuseColor=(Sdf.ValueTypeNames.Color3f, (0, 0, 0)),
        specularColor=(Sdf.ValueTypeNames.Color3f, (0, 0, 0)),
        useSpecularWorkflow=(Sdf.ValueTypeNames.Int, 1),
        roughness=(Sdf.ValueTypeNames.Float, 1.0),
    )
    surface.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f)
    out = surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(out)
    return surface


def _bind(thing: Any, path: str) -> None:
    """Bind a material to a mesh or to some of its faces."""
    from pxr import UsdShade

    prim = thing.GetPrim()
    material = UsdShade.Material.Get(prim.GetStage(), path)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
