"""USD: read and write meshes with usd-core.

A written stage has one mesh with unlit materials, and optional collision shapes.
"""

import io
import re
import zipfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.asset.writer import stored_member
from msb.base.children import run_in_child
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.base.seam_keys import hash_attributes
from msb.errors import MeshFileError, about, shorten
from msb.meshes.colors import linear_light, srgb_colors
from msb.meshes.formats import Format, Style
from msb.meshes.image_files import encode_images, name_images
from msb.meshes.images import MAX_FILE, Decoder
from msb.meshes.linked_files import read_linked_file
from msb.meshes.mesh import Mesh
from msb.meshes.source import Source
from msb.meshes.usd_stage import read_stage
from msb.meshes.writing import as_float32, check_indices

Kind = Literal["usda", "usdc", "usdz"]
# Time limit of usd-core, in seconds.
_SECONDS = 600.0
_PACKAGE = b"PK\x03\x04"
# Memory limit of usd-core: 64 bytes per byte of the file, plus 2 GiB.
_MEMORY_PER_BYTE, _EXTRA_MEMORY = 64, 2.0
_PLAIN = np.full((1, 1, 3), 255, np.uint8)


def read(source: Source) -> Mesh:
    """Return the visible meshes of a stage at its earliest time, in world coordinates.

    usd-core reads the file in a child process. Stages composed of several files are rejected; only images may
    be separate files.
    """
    need_extra("usd", "pxr", what="a USD file")
    _check_whole(source)
    memory = _EXTRA_MEMORY + _MEMORY_PER_BYTE * len(source.data) / 2**30
    # The path is absolute, because the child process has another working directory.
    reply = run_in_child(read_stage, str(Path(source.path).absolute()), {}, Limits(_SECONDS, memory))
    if reply.why:
        code = "MESH_FILE_TOO_LARGE" if reply.ended_by in ("time", "memory") else "MESH_FILE_INVALID"
        raise source.error(code, f"usd-core cannot read the file: {reply.why}")
    data, arrays = reply.data, reply.arrays
    if "refused" in data:
        raise source.error(*data["refused"])
    colors = {
        domain: srgb_colors(arrays[f"{domain}_colors"])
        for domain in ("vertex", "face", "corner")
        if f"{domain}_colors" in arrays
    }
    mesh = Mesh(
        arrays["vertices"],
        arrays["faces"],
        colors.get("vertex"),
        colors.get("face"),
        vertex_uvs=arrays.get("vertex_uvs"),
        corner_uvs=arrays.get("corner_uvs"),
        face_textures=arrays.get("face_textures"),
        left_out=tuple(data["left_out"]),
        up=data["up"],
    )
    if "corner" in colors:
        from msb.meshes.assets import with_corner_colors

        with about(source.path):
            check_indices(mesh)  # before vertices are split
        mesh = with_corner_colors(mesh, colors["corner"])
    if "corner_normals" in arrays:
        mesh = replace(mesh, corner_keys=hash_attributes([arrays["corner_normals"]]))
    return _with_textures(mesh, source, data) if data["textures"] and source.images else mesh


def _check_whole(source: Source) -> None:
    """Reject truncated packages. usd-core reads them even if the end record of the archive is missing."""
    is_package = _PACKAGE.startswith(source.data[: len(_PACKAGE)])
    if is_package and not zipfile.is_zipfile(io.BytesIO(source.data)):
        raise source.error("MESH_FILE_TRUNCATED", "the file is truncated: the package has no end record")


def _with_textures(mesh: Mesh, source: Source, data: dict[str, Any]) -> Mesh:
    """Return `mesh` with its images, from the package or from separate files."""
    decoder, images = Decoder(), []
    for name in data["textures"]:
        content = _read_image(source, name) if name else b""
        try:
            images.append(decoder.decode(content, alpha=data["cutoff"] is not None) if name else _PLAIN)
        except MeshFileError as error:
            raise source.error(error.code, f"image {shorten(name, 80)!r}: {error.message}") from None
    sampler = Sampler(wrap_u=data["wraps"][0], wrap_v=data["wraps"][1], alpha_cutoff=data["cutoff"])
    return replace(mesh, textures=tuple(images), sampler=sampler)


def _read_image(source: Source, name: str) -> bytes:
    """Return the image called `name`, from the package or from the folder of the file."""
    name = name.removeprefix("./")
    if not source.data.startswith(_PACKAGE):
        return read_linked_file(source, name, "a texture", MAX_FILE)
    try:
        with zipfile.ZipFile(io.BytesIO(source.data)) as archive:
            about = archive.getinfo(name)
            # USD packages are not compressed. A stored member cannot be larger than the file.
            if about.compress_type == zipfile.ZIP_STORED:
                return archive.read(about)
    except (KeyError, zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError):
        pass
    text = f"the package does not contain the image {shorten(name, 80)!r} uncompressed"
    raise source.error("MESH_FILE_INVALID", text)


def write(kind: Kind, mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write a stage as text, as binary, or as a package with its textures. The unit is metres; y is up.

    The default prim contains the mesh, its materials and its collision shapes. Materials are unlit: they use
    the emissive colour of UsdPreviewSurface. Vertex and face colours become `displayColor`, in linear light;
    they are not written for textured meshes, because UsdPreviewSurface cannot multiply the two. Collision
    shapes have the purpose "guide", so that they are not drawn.
    """
    need_extra("usd", "pxr", what="a USD file")
    has_images = kind == "usdz" or style.stem is not None
    layer = _build_stage(mesh, name_images(mesh, style) if has_images else [], style)
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
        for name, data in {"asset.usdc": content, **encode_images(mesh, style)}.items():
            with stored_member(archive, stream, name, len(data)) as member:
                member.write(data)


def _build_stage(mesh: Mesh, images: list[str], style: Style) -> Any:
    """Return the layer of the complete stage."""
    from pxr import Kind as Kinds
    from pxr import Sdf, Usd, UsdGeom, UsdPhysics

    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/asset")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kinds.Tokens.component)
    _add_colors(_add_mesh(stage, "/asset/mesh", mesh), mesh, images)
    for number, part in enumerate(style.collision):
        shape = _add_mesh(stage, f"/asset/collision_{number}", part)
        shape.CreatePurposeAttr(UsdGeom.Tokens.guide)
        UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
        # Concave shapes are used as triangle meshes, which simulators support for static objects.
        convex = UsdPhysics.Tokens.convexHull if style.is_convex else UsdPhysics.Tokens.none
        UsdPhysics.MeshCollisionAPI.Apply(shape.GetPrim()).CreateApproximationAttr(convex)
    return layer


def _add_mesh(stage: Any, path: str, mesh: Mesh) -> Any:
    """Define a mesh prim with the triangles of `mesh` at `path`, and return it."""
    from pxr import UsdGeom, Vt

    prim = UsdGeom.Mesh.Define(stage, path)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(as_float32(mesh.vertices, "USD"))))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.astype(np.int32).reshape(-1)))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    # Readers expect normals for surfaces without subdivision. Face normals do not smooth the surface.
    prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(_compute_normals(mesh)))
    prim.SetNormalsInterpolation(UsdGeom.Tokens.uniform)
    prim.CreateDoubleSidedAttr(True)
    if len(mesh.vertices):
        prim.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(prim.GetPointsAttr().Get()))
    return prim


def _compute_normals(mesh: Mesh) -> NDArray[np.float32]:
    """Return the unit normals (F, 3) of the faces; +y for faces without area."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    long = np.linalg.norm(across, axis=1, keepdims=True)
    return np.where(long > 0, across / np.where(long > 0, long, 1), (0, 1, 0)).astype(np.float32)


def _add_colors(prim: Any, mesh: Mesh, images: list[str]) -> None:
    """Add colours or textures and their materials to the mesh prim `prim`."""
    from pxr import Sdf, UsdGeom, UsdShade, Vt

    stage, primvars = prim.GetPrim().GetStage(), UsdGeom.PrimvarsAPI(prim)
    if not images:
        colors = mesh.face_colors if mesh.vertex_colors is None else mesh.vertex_colors
        if colors is None:
            return
        light = np.ascontiguousarray(linear_light(colors)[:, :3])
        domain = UsdGeom.Tokens.uniform if mesh.vertex_colors is None else UsdGeom.Tokens.vertex
        _set_primvar(prim.CreateDisplayColorPrimvar(domain), light, Vt.Vec3fArray)
        surface = _add_material(stage, "/asset/materials/colors")
        name = Sdf.ValueTypeNames.String, "displayColor"
        reader = _add_shader(stage, "/asset/materials/colors/read", "UsdPrimvarReader_float3", varname=name)
        color = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
        surface.GetInput("emissiveColor").ConnectToSource(color)
        _bind(prim, "/asset/materials/colors")
        return
    uvs = mesh.vertex_uvs if mesh.corner_uvs is None else mesh.corner_uvs
    assert uvs is not None
    domain = UsdGeom.Tokens.vertex if mesh.corner_uvs is None else UsdGeom.Tokens.faceVarying
    upward = np.column_stack((uvs[:, 0], 1 - uvs[:, 1])).astype(np.float32)
    _set_primvar(
        primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, domain), upward, Vt.Vec2fArray
    )
    for number, image in enumerate(images):
        _add_texture(stage, f"/asset/materials/texture_{number}", image, mesh)
        if mesh.face_textures is None:
            _bind(prim, f"/asset/materials/texture_{number}")
            continue
        faces = np.flatnonzero(mesh.face_textures == number).astype(np.int32)
        part = UsdGeom.Subset.CreateGeomSubset(
            prim,
            f"texture_{number}",
            UsdGeom.Tokens.face,
            Vt.IntArray.FromNumpy(faces),
            UsdShade.Tokens.materialBind,
            UsdGeom.Tokens.partition,
        )
        _bind(part, f"/asset/materials/texture_{number}")


def _set_primvar(primvar: Any, values: NDArray[np.float32], kind: Any) -> None:
    """Set the values of a primvar; repeated values are stored once, with indices."""
    from pxr import Vt

    bits = np.ascontiguousarray(values).view(np.uint32)
    _, first, number = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    if len(first) < len(values):
        primvar.SetIndices(Vt.IntArray.FromNumpy(number.reshape(-1).astype(np.int32)))
        values = values[first]
    primvar.Set(kind.FromNumpy(np.ascontiguousarray(values)))


def _add_texture(stage: Any, path: str, image: str, mesh: Mesh) -> None:
    """Define the unlit material of the texture file `image` at `path`."""
    from pxr import Sdf

    surface = _add_material(stage, path)
    kinds = Sdf.ValueTypeNames
    reader = _add_shader(stage, f"{path}/read", "UsdPrimvarReader_float2", varname=(kinds.String, "st"))
    texture = _add_shader(
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
    color = texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.GetInput("emissiveColor").ConnectToSource(color)
    if mesh.sampler.alpha_cutoff is not None:
        alpha = texture.CreateOutput("a", Sdf.ValueTypeNames.Float)
        surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).ConnectToSource(alpha)
        surface.CreateInput("opacityThreshold", Sdf.ValueTypeNames.Float).Set(mesh.sampler.alpha_cutoff)


def _add_shader(stage: Any, path: str, name: str, **inputs: tuple[Any, Any]) -> Any:
    """Define the shader `name` at `path`, with inputs of the given types and values, and return it."""
    from pxr import UsdShade

    shader = UsdShade.Shader.Define(stage, path)
    shader.CreateIdAttr(name)
    for key, (kind, value) in inputs.items():
        shader.CreateInput(key, kind).Set(value)
    return shader


def _add_material(stage: Any, path: str) -> Any:
    """Define a material without reflections at `path`, and return its surface shader."""
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
    surface.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f)
    out = surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(out)
    return surface


def _bind(thing: Any, path: str) -> None:
    """Bind the material at `path` to a mesh prim or to a subset of its faces."""
    from pxr import UsdShade

    prim = thing.GetPrim()
    material = UsdShade.Material.Get(prim.GetStage(), path)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def _declare_format(title: str, suffixes: tuple[str, ...], kind: Kind, begins: bytes | None) -> Format:
    """Return the format for one kind of USD file."""
    return Format(
        title,
        suffixes,
        read,
        partial(write, kind),
        begins=None if begins is None else re.compile(begins),
        companions=None if kind == "usdz" else encode_images,
        keeps=("vertex_colors", "face_colors", "textures", "collision"),
        is_single=True,
        is_linear=True,
        up="+y",
    )


FORMATS = (
    _declare_format("USD", (".usda",), "usda", rb"#usda"),
    _declare_format("USD", (".usdc", ".usd"), "usdc", rb"PXR-USDC"),
    _declare_format("USDZ", (".usdz",), "usdz", None),
)
