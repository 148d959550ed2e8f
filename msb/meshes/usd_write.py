"""Writes a USD stage with one mesh, its materials and optional collision shapes."""

import json
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from msb.asset.writer import stored_member
from msb.base.extras import need_extra
from msb.meshes.colors import linear_light
from msb.meshes.formats import Style
from msb.meshes.image_files import name_images
from msb.meshes.mesh import Mesh
from msb.meshes.placement import KEY
from msb.meshes.usd_looks import WHITE, FaceGroup, corner_light, encode_used_images, group_faces
from msb.meshes.writing import as_local

Kind = Literal["usda", "usdc", "usdz"]


def write(kind: Kind, mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write a stage as text, as binary, or as a package with its textures.

    The unit is metres, and the y axis is up.

    The default prim contains the mesh, its materials and its collision shapes. By default, materials are
    unlit: the colour is the emissive colour of UsdPreviewSurface. In lit materials, the colour is the diffuse
    colour. Vertex and face colours become `displayColor`, in linear light. The colours of textured meshes
    become material colours (`msb.meshes.usd_looks`). Collision shapes have the purpose "guide", so that they
    are not drawn.
    """
    need_extra("usd", "pxr", what="a USD file")
    has_images = kind == "usdz" or style.stem is not None
    layer = build_stage(mesh, name_images(mesh, style) if has_images else [], style)
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
    # The first member of a USDZ package is its root layer.
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {"asset.usdc": content, **encode_used_images(mesh, style)}.items():
            with stored_member(archive, stream, name, len(data)) as member:
                member.write(data)


def build_stage(mesh: Mesh, images: list[str], style: Style) -> Any:
    """Return the layer of the complete stage."""
    from pxr import Kind as Kinds
    from pxr import Sdf, Usd, UsdGeom, UsdPhysics

    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    if mesh.placement is not None:
        layer.customLayerData = {KEY: json.dumps(mesh.placement.to_json())}
    root = UsdGeom.Xform.Define(stage, "/asset")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kinds.Tokens.component)
    color_input = "diffuseColor" if style.is_lit else "emissiveColor"
    _add_colors(_add_mesh(stage, "/asset/mesh", mesh), mesh, images, color_input)
    for number, part in enumerate(style.collision):
        shape = _add_mesh(stage, f"/asset/collision_{number}", part)
        shape.CreatePurposeAttr(UsdGeom.Tokens.guide)
        UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
        # Concave collision shapes are triangle meshes, which simulators support for static objects.
        convex = UsdPhysics.Tokens.convexHull if style.is_convex else UsdPhysics.Tokens.none
        UsdPhysics.MeshCollisionAPI.Apply(shape.GetPrim()).CreateApproximationAttr(convex)
    return layer


def _add_mesh(stage: Any, path: str, mesh: Mesh) -> Any:
    """Define a mesh prim with the triangles of `mesh` at `path`. Return the prim."""
    from pxr import Gf, UsdGeom, Vt

    prim = UsdGeom.Mesh.Define(stage, path)
    points, origin = as_local(mesh.vertices, "USD")
    if any(origin):
        prim.AddTranslateOp().Set(Gf.Vec3d(*origin))
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points)))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.astype(np.int32).reshape(-1)))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    # Without subdivision, readers expect normals. With face normals, the surface is rendered flat-shaded.
    normals, domain = mesh.corner_normals, UsdGeom.Tokens.faceVarying
    if normals is None:
        normals, domain = _compute_normals(mesh), UsdGeom.Tokens.uniform
    prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(normals)))
    prim.SetNormalsInterpolation(domain)
    prim.CreateDoubleSidedAttr(True)
    if len(mesh.vertices):
        prim.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(prim.GetPointsAttr().Get()))
    return prim


def _compute_normals(mesh: Mesh) -> NDArray[np.float32]:
    """Return the unit normals (F, 3) of the faces. Faces without area get +y."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    long = np.linalg.norm(across, axis=1, keepdims=True)
    return np.where(long > 0, across / np.where(long > 0, long, 1), (0, 1, 0)).astype(np.float32)


def _add_colors(prim: Any, mesh: Mesh, images: list[str], color_input: str) -> None:
    """Add colours, or textures with materials, to a mesh prim.

    The colour is set at `color_input` of the surface shader.
    """
    from pxr import Sdf, UsdGeom, Vt

    if not images:
        colors = mesh.face_colors if mesh.vertex_colors is None else mesh.vertex_colors
        if colors is None:
            return
        domain = UsdGeom.Tokens.uniform if mesh.vertex_colors is None else UsdGeom.Tokens.vertex
        _add_display_colors(prim, linear_light(colors)[:, :3], domain, color_input)
        _bind(prim, "/asset/materials/colors")
        return
    groups = group_faces(mesh)
    if any(group.image is not None for group in groups):
        uvs = mesh.vertex_uvs if mesh.corner_uvs is None else mesh.corner_uvs
        assert uvs is not None
        domain = UsdGeom.Tokens.vertex if mesh.corner_uvs is None else UsdGeom.Tokens.faceVarying
        upward = np.column_stack((uvs[:, 0], 1 - uvs[:, 1])).astype(np.float32)
        primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, domain)
        _set_primvar(primvar, upward, Vt.Vec2fArray)
    if any(group.color is None for group in groups):
        light = corner_light(mesh).reshape(-1, 3)
        _add_display_colors(prim, light, UsdGeom.Tokens.faceVarying, color_input)
    for name, group in zip(_name_groups(groups), groups, strict=True):
        if group.color is not None:
            _add_group(prim, f"/asset/materials/{name}", group, images, mesh, color_input)
        _bind(prim if len(groups) == 1 else _add_subset(prim, name, group), f"/asset/materials/{name}")


def _add_display_colors(prim: Any, light: NDArray[np.float32], domain: str, color_input: str) -> None:
    """Set `displayColor` to the colours `light` (n, 3) of a domain, and define a material that shows
    `displayColor`."""
    from pxr import Sdf, Vt

    stage = prim.GetPrim().GetStage()
    _set_primvar(prim.CreateDisplayColorPrimvar(domain), np.ascontiguousarray(light), Vt.Vec3fArray)
    surface = _add_material(stage, "/asset/materials/colors", color_input)
    name = Sdf.ValueTypeNames.String, "displayColor"
    reader = _add_shader(stage, "/asset/materials/colors/read", "UsdPrimvarReader_float3", varname=name)
    color = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface.GetInput(color_input).ConnectToSource(color)


def _name_groups(groups: list[FaceGroup]) -> list[str]:
    """Return a name for the material of each group."""
    several = {group.image for group in groups if sum(other.image == group.image for other in groups) > 1}
    names = []
    for number, group in enumerate(groups):
        if group.image is None:
            names.append("colors" if group.color is None else f"color_{number}")
        else:
            end = f"_{number}" if group.image in several else ""
            names.append(f"texture_{group.image}{end}")
    return names


def _add_group(
    prim: Any, path: str, group: FaceGroup, images: list[str], mesh: Mesh, color_input: str
) -> None:
    """Define the material of a group of faces.

    The material shows an image multiplied with a colour, or only a colour.
    """
    stage = prim.GetPrim().GetStage()
    assert group.color is not None
    if group.image is None:
        _add_material(stage, path, color_input).GetInput(color_input).Set(group.color)
    else:
        _add_texture(stage, path, images[group.image], mesh, group.color, color_input)


def _add_subset(prim: Any, name: str, group: FaceGroup) -> Any:
    """Define the faces of a group as a subset of a mesh prim, and bind the group's material to it."""
    from pxr import UsdGeom, UsdShade, Vt

    return UsdGeom.Subset.CreateGeomSubset(
        prim,
        name,
        UsdGeom.Tokens.face,
        Vt.IntArray.FromNumpy(group.faces),
        UsdShade.Tokens.materialBind,
        UsdGeom.Tokens.partition,
    )


def _set_primvar(primvar: Any, values: NDArray[np.float32], kind: Any) -> None:
    """Set the values of a primvar. Repeated values are stored once, and indices refer to them."""
    from pxr import Vt

    bits = np.ascontiguousarray(values).view(np.uint32)
    _, first, number = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    if len(first) < len(values):
        primvar.SetIndices(Vt.IntArray.FromNumpy(number.reshape(-1).astype(np.int32)))
        values = values[first]
    primvar.Set(kind.FromNumpy(np.ascontiguousarray(values)))


def _add_texture(
    stage: Any, path: str, image: str, mesh: Mesh, color: tuple[float, ...], color_input: str
) -> None:
    """Define a material at `path`.

    The material shows the texture file `image` multiplied with `color` (linear light).
    """
    from pxr import Sdf

    surface = _add_material(stage, path, color_input)
    kinds = Sdf.ValueTypeNames
    reader = _add_shader(stage, f"{path}/read", "UsdPrimvarReader_float2", varname=(kinds.String, "st"))
    at = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)

    def add_sampler(name: str, space: str) -> Any:
        sampler = _add_shader(
            stage,
            f"{path}/{name}",
            "UsdUVTexture",
            file=(kinds.Asset, Sdf.AssetPath(f"./{image}")),
            sourceColorSpace=(kinds.Token, space),
            wrapS=(kinds.Token, mesh.sampler.wrap_u),
            wrapT=(kinds.Token, mesh.sampler.wrap_v),
        )
        sampler.CreateInput("st", kinds.Float2).ConnectToSource(at)
        return sampler

    texture = add_sampler("texture", "sRGB")
    if color != WHITE:
        texture.CreateInput("scale", kinds.Float4).Set((*color, 1.0))
    color = texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.GetInput(color_input).ConnectToSource(color)
    if mesh.sampler.alpha_cutoff is not None:
        # Alpha is not a colour, so it has a reader of its own.
        alpha = add_sampler("alpha", "raw").CreateOutput("a", Sdf.ValueTypeNames.Float)
        surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).ConnectToSource(alpha)
        surface.CreateInput("opacityThreshold", Sdf.ValueTypeNames.Float).Set(mesh.sampler.alpha_cutoff)


def _add_shader(stage: Any, path: str, name: str, **inputs: tuple[Any, Any]) -> Any:
    """Define the shader `name` at `path`, with inputs of the given types and values. Return the shader."""
    from pxr import UsdShade

    shader = UsdShade.Shader.Define(stage, path)
    shader.CreateIdAttr(name)
    for key, (kind, value) in inputs.items():
        shader.CreateInput(key, kind).Set(value)
    return shader


def _add_material(stage: Any, path: str, color_input: str) -> Any:
    """Define a material without reflections at `path`. Return the surface shader of the material.

    The input `color_input` sets the colour. All other colours are black.
    """
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, "/asset/materials")
    material = UsdShade.Material.Define(stage, path)
    surface = _add_shader(
        stage,
        f"{path}/surface",
        "UsdPreviewSurface",
        diffuseColor=(Sdf.ValueTypeNames.Color3f, (0, 0, 0)),
        specularColor=(Sdf.ValueTypeNames.Color3f, (0, 0, 0)),
        useSpecularWorkflow=(Sdf.ValueTypeNames.Int, 1),
        roughness=(Sdf.ValueTypeNames.Float, 1.0),
    )
    surface.CreateInput(color_input, Sdf.ValueTypeNames.Color3f)
    out = surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(out)
    return surface


def _bind(thing: Any, path: str) -> None:
    """Bind the material at `path` to a mesh prim or to a subset of its faces."""
    from pxr import UsdShade

    prim = thing.GetPrim()
    material = UsdShade.Material.Get(prim.GetStage(), path)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
