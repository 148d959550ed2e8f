"""Read the visible meshes of a USD stage as arrays. This runs usd-core, in a child process."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.meshes.polygons import fan_triangulate, join_faces

Floats = NDArray[np.float32]

# Interpolation of a primvar -> the domain of its values; others are per vertex.
_DOMAINS = {"uniform": "face", "faceVarying": "corner"}
_WRAPS = {"clamp": "clamp", "black": "clamp", "mirror": "mirror"}


@dataclass
class _PrimArrays:
    """The triangles of a mesh prim with their colours, UVs and textures.

    `colors` (linear light) and `uvs` are None, or a domain ("vertex", "face", "corner") and its values.
    `textures` (F,) are image numbers. `normals` explain duplicated vertices; they are not kept.
    """

    points: NDArray[Any]
    faces: NDArray[np.int64]
    colors: tuple[str, Floats] | None
    uvs: tuple[str, Floats] | None
    textures: NDArray[np.uint32]
    normals: tuple[str, Floats] | None = None


@dataclass(frozen=True)
class _Material:
    """A material: its image ("" without one), UV primvar, wrap modes, alpha cut-off, and uniform colour."""

    image: str = ""
    varname: str = "st"
    wraps: tuple[str, str] = ("repeat", "repeat")
    cutoff: float | None = None
    color: tuple[float, ...] | None = None


def read_stage(word: str, _: Arrays) -> tuple[Any, Arrays]:
    """Read the file `word`. This runs in the child process; it is a `Work` of `msb.base.children`."""
    from pxr import Sdf, Tf, Usd, UsdGeom

    try:
        layer = Sdf.Layer.FindOrOpen(word)
        needs = layer.GetCompositionAssetDependencies() if layer else []
        stage = Usd.Stage.Open(layer) if layer and not needs else None
    except Tf.ErrorException:
        layer = None
    if layer is None:
        return {"refused": ("MESH_FILE_INVALID", "usd-core finds no stage in the file; export it again")}, {}
    if needs:
        text = f"the stage refers to other files ({needs[0][:80]}); merge them with usdcat --flatten"
        return {"refused": ("MESH_FILE_UNSUPPORTED", text)}, {}
    reader = _Reader(UsdGeom.XformCache(Usd.TimeCode.EarliestTime()))
    try:
        parts = [reader.read_prim(UsdGeom.Mesh(prim)) for prim in reader.visible_meshes(stage)]
    except _Refused as refused:
        return {"refused": ("MESH_FILE_INVALID", str(refused))}, {}
    if not parts:
        return {"refused": ("MESH_FILE_INVALID", "the stage has no visible mesh")}, {}
    up = "+z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "+y"
    # The mesh has one sampler: that of the first textured material.
    first = next((material for material in reader.materials.values() if material.image), _Material())
    textures = list(reader.images) if any(reader.images) else []
    data = {
        "up": up,
        "textures": textures,
        "wraps": first.wraps,
        "cutoff": first.cutoff,
        "left_out": list(reader.left_out),
    }
    return data, _join_parts(parts, textures)


class _Refused(Exception):
    """The stage is invalid; the text is the reason."""


class _Reader:
    """Reads the mesh prims of a stage.

    `images` numbers the images in the order of their use, and `left_out` collects what is not read.
    """

    def __init__(self, places: Any) -> None:
        self._places, self._time = places, places.GetTime()
        self.materials: dict[str, _Material] = {}
        self.images: dict[str, int] = {}
        self.left_out: dict[str, None] = {}

    def visible_meshes(self, stage: Any) -> Iterator[Any]:
        """Yield the mesh prims that are rendered, including instances."""
        from pxr import Usd, UsdGeom

        drawn = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
        for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Imageable):
                continue
            imageable = UsdGeom.Imageable(prim)
            if imageable.ComputeVisibility(self._time) == UsdGeom.Tokens.invisible:
                continue
            if imageable.ComputePurpose() not in drawn:
                self.left_out["guides and proxies"] = None
            elif prim.IsA(UsdGeom.Mesh):
                yield prim
            elif prim.IsA(UsdGeom.PointInstancer):
                self.left_out["instances of meshes (PointInstancer)"] = None
            elif prim.IsA(UsdGeom.Gprim):
                self.left_out[f"shapes other than meshes ({prim.GetTypeName()})"] = None

    def read_prim(self, mesh: Any) -> _PrimArrays:
        """Return the triangles of a mesh prim with their colours or textures."""
        from pxr import UsdGeom

        prim = mesh.GetPrim()
        points = self._read_array(mesh.GetPointsAttr(), np.float32, (-1, 3))
        counts = self._read_array(mesh.GetFaceVertexCountsAttr(), np.int64, (-1,))
        corners = self._read_array(mesh.GetFaceVertexIndicesAttr(), np.int64, (-1,))
        if (counts < 0).any() or counts.sum() != len(corners):
            text = f"{prim.GetPath()}: the faces need {counts.sum()} corners, but there are {len(corners)}"
            raise _Refused(text)
        # order (F, 3) are places in `corners`, polygon (F,) the polygon of each triangle.
        order, polygon = fan_triangulate(np.arange(len(corners)), counts)
        # Transform to world coordinates. A mirroring transform reverses the winding, like left-handed
        # orientation.
        matrix = np.array(self._places.GetLocalToWorldTransform(prim))
        is_left = mesh.GetOrientationAttr().Get(self._time) == UsdGeom.Tokens.leftHanded
        if not np.array_equal(matrix, np.eye(4)):
            with np.errstate(over="ignore", invalid="ignore"):
                points = points.astype(np.float64) @ matrix[:3, :3] + matrix[3, :3]
                is_left ^= np.linalg.det(matrix[:3, :3]) < 0
        if is_left:
            order = order[:, [0, 2, 1]]
        # Number the images of the materials, and assign them to the polygons: first the material of the prim,
        # then those of its subsets.
        materials = self._read_materials(mesh, len(counts))
        numbers = np.array([self.images.setdefault(mat.image, len(self.images)) for mat, _ in materials])
        textures = np.zeros(len(counts), np.uint32)
        for number, (_, faces) in zip(numbers, materials, strict=True):
            textures[faces] = number
        self._note_ignored(mesh)
        arrays = _PrimArrays(points, corners[order], None, None, textures[polygon])
        arrays.normals = self._read_normals(mesh, order)
        # A prim has texture coordinates, with v upwards, or else colours.
        shape = len(points), len(counts), len(corners)
        varname = next((material.varname for material, _ in materials if material.image), None)
        if varname is not None:
            arrays.uvs = self._read_primvar(mesh, varname, 2, shape, order, polygon)
            if arrays.uvs is None:
                self.left_out["textures without UVs"] = None
                arrays.textures[:] = self.images.setdefault("", len(self.images))
            else:
                arrays.uvs[1][:, 1] = 1 - arrays.uvs[1][:, 1]
        if varname is None or arrays.uvs is None:
            arrays.colors = self._read_primvar(mesh, "displayColor", 3, shape, order, polygon)
            if arrays.colors is None:
                arrays.colors = _collect_material_colors(materials, len(points), polygon, len(counts))
        elif any(material.color is not None for material, _ in materials):
            self.left_out["colours of materials"] = None
        return arrays

    def _read_array(self, attribute: Any, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the values of an attribute; an empty array if it is not set."""
        stored = attribute.Get(self._time)
        return np.array([] if stored is None else stored, dtype).reshape(shape)

    def _read_primvar(
        self,
        mesh: Any,
        name: str,
        width: int,
        shape: tuple[int, int, int],
        order: NDArray[np.int64],
        polygon: NDArray[np.int64],
    ) -> tuple[str, Floats] | None:
        """Return the domain of the primvar `name` and its values (n, `width`), or None if it is not set.

        `shape` are the numbers of vertices, polygons and polygon corners; `order` and `polygon` are as in
        `read_prim`. Values of polygons become values of triangles.
        """
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            return None
        stored = primvar.ComputeFlattened(self._time)
        values = np.array([] if stored is None else stored, np.float32)
        kind = str(primvar.GetInterpolation())
        domain = _DOMAINS.get(kind, "vertex")
        count = {"vertex": shape[0], "face": shape[1], "corner": shape[2]}[domain]
        if kind == "constant" and values.size == width:
            values = np.tile(values.reshape(1, width), (count, 1))
        if values.shape != (count, width):
            text = f"it has {len(values)} values of {name}, but {count} are needed"
            raise _Refused(f"{mesh.GetPrim().GetPath()}: {text}")
        if domain == "face":
            return domain, values[polygon]
        return domain, values[order.reshape(-1)] if domain == "corner" else values

    def _read_normals(self, mesh: Any, order: NDArray[np.int64]) -> tuple[str, Floats] | None:
        """Return the domain and the normals (n, 3) of vertices or corners, or None if they are invalid."""
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
        if primvar and primvar.HasValue():
            stored, kind = primvar.ComputeFlattened(self._time), str(primvar.GetInterpolation())
        else:
            stored, kind = mesh.GetNormalsAttr().Get(self._time), str(mesh.GetNormalsInterpolation())
        values = np.array([] if stored is None else stored, np.float32).reshape(-1, 3)
        domain = _DOMAINS.get(kind, "vertex")
        rows = {
            "vertex": len(mesh.GetPointsAttr().Get(self._time) or ()),
            "corner": int(order.max(initial=-1)) + 1,
        }
        if not len(values) or kind == "constant" or len(values) < rows.get(domain, len(values) + 1):
            return None
        return domain, values[order.reshape(-1)] if domain == "corner" else values

    def _read_materials(self, mesh: Any, count: int) -> list[tuple[_Material, Any]]:
        """Return the materials of a mesh with `count` polygons, each with the numbers of its polygons."""
        from pxr import UsdGeom, UsdShade

        materials: list[tuple[_Material, Any]] = [(self._find_material(mesh.GetPrim()), slice(None))]
        kind = UsdShade.Tokens.materialBind
        for part in UsdGeom.Subset.GetGeomSubsets(mesh, UsdGeom.Tokens.face, kind):
            faces = self._read_array(part.GetIndicesAttr(), np.int64, (-1,))
            if faces.size and not 0 <= faces.min() <= faces.max() < count:
                raise _Refused(f"{part.GetPrim().GetPath()}: it selects faces that do not exist")
            materials.append((self._find_material(part.GetPrim()), faces))
        return materials

    def _find_material(self, prim: Any) -> _Material:
        """Return the material of a prim; each material is read once."""
        from pxr import UsdShade

        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not material:
            return _Material()
        path = str(material.GetPath())
        if path not in self.materials:
            self.materials[path] = self._read_surface(material)
        return self.materials[path]

    def _read_surface(self, material: Any) -> _Material:
        """Return the material of a surface shader: its texture or its uniform colour."""
        surface = material.ComputeSurfaceSource()[0]
        if not surface or surface.GetShaderId() != "UsdPreviewSurface":
            self.left_out["materials other than UsdPreviewSurface"] = None
            return _Material()
        for name in ("emissiveColor", "diffuseColor"):
            given = surface.GetInput(name)
            source = given.GetConnectedSources()[0] if given else []
            if source:
                reader = _get_shader(source[0])
                if reader and reader.GetShaderId() == "UsdUVTexture":
                    return self._read_texture(surface, reader)
                return _Material()  # the primvar displayColor, which is read from the mesh
        color = self._read_value(surface, "diffuseColor")
        return _Material() if color is None else _Material(color=tuple(color))

    def _read_texture(self, surface: Any, reader: Any) -> _Material:
        """Return the material of a texture reader that is connected to `surface`."""
        file = self._read_value(reader, "file")
        if file is None or not file.path or "<UDIM>" in file.path:
            self.left_out["textures in several images (UDIM)"] = None
            return _Material()
        varname = "st"
        given = reader.GetInput("st")
        for source in given.GetConnectedSources()[0] if given else []:
            placed = _get_shader(source)
            if placed and placed.GetShaderId() == "UsdTransform2d":
                self.left_out["transforms of textures"] = None
            elif placed and placed.GetInput("varname"):
                varname = str(self._read_value(placed, "varname"))
        u, v = (_WRAPS.get(str(self._read_value(reader, name)), "repeat") for name in ("wrapS", "wrapT"))
        cutoff = float(self._read_value(surface, "opacityThreshold") or 0)
        return _Material(file.path, varname, (u, v), cutoff or None)

    def _read_value(self, shader: Any, name: str) -> Any:
        """Return the value of a shader's input, or None if the input does not exist."""
        given = shader.GetInput(name)
        return given.Get(self._time) if given else None

    def _note_ignored(self, mesh: Any) -> None:
        """Add the names of the data in a mesh prim that is not read to `left_out`."""
        from pxr import UsdGeom

        if mesh.GetNormalsAttr().HasAuthoredValue():
            self.left_out["normals"] = None
        if mesh.GetHoleIndicesAttr().HasAuthoredValue():
            self.left_out["holes"] = None
        scheme = mesh.GetSubdivisionSchemeAttr()
        if scheme.HasAuthoredValue() and scheme.Get(self._time) != UsdGeom.Tokens.none:
            self.left_out["subdivision"] = None
        if mesh.GetPointsAttr().GetNumTimeSamples() > 1:
            self.left_out["animation"] = None


def _collect_material_colors(
    materials: list[tuple[_Material, Any]], vertices: int, polygon: NDArray[np.int64], polygons: int
) -> tuple[str, Floats] | None:
    """Return the materials' uniform colours: per vertex for one material, else per face, or None.

    Faces whose material has no colour are white. `polygon` (F,) is the polygon of each triangle.
    """
    if all(material.color is None for material, _ in materials):
        return None
    if len(materials) == 1:
        return "vertex", np.tile(np.array(materials[0][0].color, np.float32), (vertices, 1))
    colors = np.ones((polygons, 3), np.float32)
    for material, faces in materials:
        if material.color is not None:
            colors[faces] = material.color
    return "face", colors[polygon]


def _get_shader(source: Any) -> Any:
    """Return the shader of a connected source."""
    from pxr import UsdShade

    return UsdShade.Shader(source.source.GetPrim())


def _join_parts(parts: list[_PrimArrays], textures: list[str]) -> dict[str, NDArray[Any]]:
    """Return the concatenated arrays of all parts, under the names that `msb.meshes.usd` expects."""
    arrays: dict[str, NDArray[Any]] = {
        "vertices": np.concatenate([part.points for part in parts]),
        "faces": join_faces((part.faces for part in parts), [len(part.points) for part in parts]),
    }
    if len(textures) > 1:
        arrays["face_textures"] = np.concatenate([part.textures for part in parts])
    if any(part.normals is not None for part in parts):
        rows = [_convert_domain("corner", part, part.normals, 3, 0.0) for part in parts]
        arrays["corner_normals"] = np.concatenate(rows)
    for name, width, blank in (("colors", 3, 1.0), ("uvs", 2, 0.0)):
        # Keep the domain if it is the same for all parts; otherwise convert the values to corners.
        values = [getattr(part, name) for part in parts]
        domains = {value[0] for value in values if value is not None}
        if not domains:
            continue
        domain = domains.pop() if len(domains) == 1 else "corner"
        if (name, domain) == ("uvs", "face"):
            domain = "corner"
        rows = [_convert_domain(domain, *pair, width, blank) for pair in zip(parts, values, strict=True)]
        arrays[f"{domain}_{name}"] = np.concatenate(rows)
    return arrays


def _convert_domain(
    domain: str, part: _PrimArrays, values: tuple[str, Floats] | None, width: int, blank: float
) -> Floats:
    """Return the values (n, `width`) of a part, converted to `domain`; `blank` if it has no values."""
    count = {"vertex": len(part.points), "face": len(part.faces), "corner": part.faces.size}[domain]
    if values is None:
        return np.full((count, width), blank, np.float32)
    if values[0] == domain:
        return values[1]
    if values[0] == "face":
        return np.repeat(values[1], 3, axis=0)
    rows: Floats = values[1][part.faces.reshape(-1).clip(0, max(len(values[1]) - 1, 0))]
    return rows
