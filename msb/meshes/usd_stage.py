"""What a stage of USD shows, as arrays: the part of the reader that runs usd-core in a process of its own."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.meshes.polygons import fan_triangulate, joined_faces

Floats = NDArray[np.float32]

# Interpolation of a primvar -> what has a value of its own; all others have one by vertex.
_OF = {"uniform": "face", "faceVarying": "corner"}
_WRAPS = {"clamp": "clamp", "black": "clamp", "mirror": "mirror"}


@dataclass
class _Part:
    """A mesh prim: its triangles, and for each what it shows.

    Colours are in linear light. `textures` are the numbers of images, by face. `colors` and `uvs` are each
    None, or of which of "vertex", "face" and "corner" there are values, and these.
    """

    points: NDArray[Any]
    faces: NDArray[np.int64]
    colors: tuple[str, Floats] | None
    uvs: tuple[str, Floats] | None
    textures: NDArray[np.uint32]


@dataclass(frozen=True)
class _Look:
    """A material: its image ("" for none), the primvar that places it, how it repeats, and plain colour."""

    image: str = ""
    varname: str = "st"
    wraps: tuple[str, str] = ("repeat", "repeat")
    cutoff: float | None = None
    color: tuple[float, ...] | None = None


def stage_parts(word: str, _: Arrays) -> tuple[Any, Arrays]:
    """Read the file `word`; a `Work` of `msb.base.children`."""
    from pxr import Sdf, Tf, Usd, UsdGeom

    try:
        layer = Sdf.Layer.FindOrOpen(word)
        needs = layer.GetCompositionAssetDependencies() if layer else []
        stage = Usd.Stage.Open(layer) if layer and not needs else None
    except Tf.ErrorException:
        layer = None
    if layer is None:
        return {"refused": ("MESH_FILE_INVALID", "usd-core finds no stage in it; save it again")}, {}
    if needs:
        text = f"it is put together from other files ({needs[0][:80]}); usdcat --flatten makes one of them"
        return {"refused": ("MESH_FILE_UNSUPPORTED", text)}, {}
    reader = _Reader(UsdGeom.XformCache(Usd.TimeCode.EarliestTime()))
    try:
        parts = [reader.part(UsdGeom.Mesh(prim)) for prim in reader.shown(stage)]
    except _Refused as refused:
        return {"refused": ("MESH_FILE_INVALID", str(refused))}, {}
    if not parts:
        return {"refused": ("MESH_FILE_INVALID", "the stage shows no mesh")}, {}
    up = "+z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "+y"
    first = next((look for look in reader.looks.values() if look.image), _Look())
    textures = list(reader.images) if any(reader.images) else []
    data = {
        "up": up,
        "textures": textures,
        "wraps": first.wraps,
        "cutoff": first.cutoff,
        "left_out": list(reader.left_out),
    }
    return data, _joined(parts, textures)


class _Refused(Exception):
    """What is in the file is no mesh; the text says why."""


class _Reader:
    """Reads the mesh prims of a stage."""

    def __init__(self, places: Any) -> None:
        self._places, self._time = places, places.GetTime()
        self.looks: dict[str, _Look] = {}
        self.images: dict[str, int] = {}
        self.left_out: dict[str, None] = {}

    def shown(self, stage: Any) -> Iterator[Any]:
        """Yield the prims of meshes that are drawn, copies included."""
        from pxr import Usd, UsdGeom

        drawn = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
        for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Imageable):
                continue
            thing = UsdGeom.Imageable(prim)
            if thing.ComputeVisibility(self._time) == UsdGeom.Tokens.invisible:
                continue
            if thing.ComputePurpose() not in drawn:
                self.left_out["guides and proxies"] = None
            elif prim.IsA(UsdGeom.Mesh):
                yield prim
            elif prim.IsA(UsdGeom.PointInstancer):
                self.left_out["further copies of meshes (PointInstancer)"] = None
            elif prim.IsA(UsdGeom.Gprim):
                self.left_out[f"shapes that are no meshes ({prim.GetTypeName()})"] = None

    def part(self, mesh: Any) -> _Part:
        """Return the triangles and colours of a mesh prim."""
        from pxr import UsdGeom

        prim = mesh.GetPrim()
        points = self._array(mesh.GetPointsAttr(), np.float32, (-1, 3))
        counts = self._array(mesh.GetFaceVertexCountsAttr(), np.int64, (-1,))
        corners = self._array(mesh.GetFaceVertexIndicesAttr(), np.int64, (-1,))
        if (counts < 0).any() or counts.sum() != len(corners):
            text = f"{prim.GetPath()}: its faces have {counts.sum()} corners, and {len(corners)} are given"
            raise _Refused(text)
        order, polygon = fan_triangulate(np.arange(len(corners)), counts)
        matrix = np.array(self._places.GetLocalToWorldTransform(prim))
        is_left = mesh.GetOrientationAttr().Get(self._time) == UsdGeom.Tokens.leftHanded
        if not np.array_equal(matrix, np.eye(4)):
            with np.errstate(over="ignore", invalid="ignore"):
                points = points.astype(np.float64) @ matrix[:3, :3] + matrix[3, :3]
                is_left ^= np.linalg.det(matrix[:3, :3]) < 0
        if is_left:
            order = order[:, [0, 2, 1]]
        looks = self._looks(mesh, len(counts))
        numbers = np.array([self.images.setdefault(look.image, len(self.images)) for look, _ in looks])
        own = np.zeros(len(counts), np.uint32)
        for number, (_, faces) in zip(numbers, looks, strict=True):
            own[faces] = number
        self._note(mesh)
        made = _Part(points, corners[order], None, None, own[polygon])
        shape = len(points), len(counts), len(corners)
        varname = next((look.varname for look, _ in looks if look.image), None)
        if varname is not None:
            made.uvs = self._primvar(mesh, varname, 2, shape, order, polygon)
            if made.uvs is None:
                self.left_out["textures that have no UVs"] = None
                made.textures[:] = self.images.setdefault("", len(self.images))
            else:
                made.uvs[1][:, 1] = 1 - made.uvs[1][:, 1]
        if varname is None or made.uvs is None:
            made.colors = self._primvar(mesh, "displayColor", 3, shape, order, polygon)
            if made.colors is None:
                made.colors = _plain_colors(looks, len(points), polygon, len(counts))
        elif any(look.color is not None for look, _ in looks):
            self.left_out["colours of materials"] = None
        return made

    def _array(self, attribute: Any, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return what an attribute holds, nothing of one that is not there."""
        stored = attribute.Get(self._time)
        return np.array([] if stored is None else stored, dtype).reshape(shape)

    def _primvar(
        self,
        mesh: Any,
        name: str,
        width: int,
        shape: tuple[int, int, int],
        order: NDArray[np.int64],
        polygon: NDArray[np.int64],
    ) -> tuple[str, Floats] | None:
        """Return of what a primvar has values, and these: of vertices, of triangles or of their corners."""
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            return None
        stored = primvar.ComputeFlattened(self._time)
        values = np.array([] if stored is None else stored, np.float32)
        kind = str(primvar.GetInterpolation())
        of = _OF.get(kind, "vertex")
        wanted = {"vertex": shape[0], "face": shape[1], "corner": shape[2]}[of]
        if kind == "constant" and values.size == width:
            values = np.tile(values.reshape(1, width), (wanted, 1))
        if values.shape != (wanted, width):
            there = f"{len(values)} values of {name}, and {wanted} are needed"
            raise _Refused(f"{mesh.GetPrim().GetPath()}: it has {there}")
        return of, values if of == "vertex" else values[polygon] if of == "face" else values[
            order.reshape(-1)
        ]

    def _looks(self, mesh: Any, count: int) -> list[tuple[_Look, Any]]:
        """Return the materials of a mesh, each with its polygons."""
        from pxr import UsdGeom, UsdShade

        found: list[tuple[_Look, Any]] = [(self._look(mesh.GetPrim()), slice(None))]
        kind = UsdShade.Tokens.materialBind
        for part in UsdGeom.Subset.GetGeomSubsets(mesh, UsdGeom.Tokens.face, kind):
            faces = self._array(part.GetIndicesAttr(), np.int64, (-1,))
            if faces.size and not 0 <= faces.min() <= faces.max() < count:
                raise _Refused(f"{part.GetPrim().GetPath()}: it has faces that the mesh has not")
            found.append((self._look(part.GetPrim()), faces))
        return found

    def _look(self, prim: Any) -> _Look:
        """Return what the material of a prim shows, each material read once."""
        from pxr import UsdShade

        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not material:
            return _Look()
        path = str(material.GetPath())
        if path not in self.looks:
            self.looks[path] = self._of_material(material)
        return self.looks[path]

    def _of_material(self, material: Any) -> _Look:
        surface = material.ComputeSurfaceSource()[0]
        if not surface or surface.GetShaderId() != "UsdPreviewSurface":
            self.left_out["materials that are no UsdPreviewSurface"] = None
            return _Look()
        for name in ("emissiveColor", "diffuseColor"):
            given = surface.GetInput(name)
            source = given.GetConnectedSources()[0] if given else []
            if source:
                reader = _shader(source[0])
                if reader and reader.GetShaderId() == "UsdUVTexture":
                    return self._of_texture(surface, reader)
                return _Look()  # displayColor, which is read of the mesh
        color = self._value(surface, "diffuseColor")
        return _Look() if color is None else _Look(color=tuple(color))

    def _of_texture(self, surface: Any, reader: Any) -> _Look:
        file = self._value(reader, "file")
        if file is None or not file.path or "<UDIM>" in file.path:
            self.left_out["textures in several images (UDIM)"] = None
            return _Look()
        varname = "st"
        given = reader.GetInput("st")
        for source in given.GetConnectedSources()[0] if given else []:
            placed = _shader(source)
            if placed and placed.GetShaderId() == "UsdTransform2d":
                self.left_out["transforms of textures"] = None
            elif placed and placed.GetInput("varname"):
                varname = str(self._value(placed, "varname"))
        u, v = (_WRAPS.get(str(self._value(reader, name)), "repeat") for name in ("wrapS", "wrapT"))
        cutoff = float(self._value(surface, "opacityThreshold") or 0)
        return _Look(file.path, varname, (u, v), cutoff or None)

    def _value(self, shader: Any, name: str) -> Any:
        """Return the value of an input of a shader, None if it has no such input."""
        given = shader.GetInput(name)
        return given.Get(self._time) if given else None

    def _note(self, mesh: Any) -> None:
        """Remember what of a mesh is not read."""
        from pxr import UsdGeom

        if mesh.GetNormalsAttr().HasAuthoredValue():
            self.left_out["normals"] = None
        if mesh.GetHoleIndicesAttr().HasAuthoredValue():
            self.left_out["holes"] = None
        scheme = mesh.GetSubdivisionSchemeAttr()
        if scheme.HasAuthoredValue() and scheme.Get(self._time) != UsdGeom.Tokens.none:
            self.left_out["subdivision"] = None
        if mesh.GetPointsAttr().GetNumTimeSamples() > 1:
            self.left_out["later times"] = None


def _plain_colors(
    looks: list[tuple[_Look, Any]], vertices: int, polygon: NDArray[np.int64], polygons: int
) -> tuple[str, Floats] | None:
    """Return the colours of materials: of vertices if one has all faces, else of faces, white without any."""
    if all(look.color is None for look, _ in looks):
        return None
    if len(looks) == 1:
        return "vertex", np.tile(np.array(looks[0][0].color, np.float32), (vertices, 1))
    own = np.ones((polygons, 3), np.float32)
    for look, faces in looks:
        if look.color is not None:
            own[faces] = look.color
    return "face", own[polygon]


def _shader(source: Any) -> Any:
    from pxr import UsdShade

    return UsdShade.Shader(source.source.GetPrim())


def _joined(parts: list[_Part], textures: list[str]) -> dict[str, NDArray[Any]]:
    """Return the arrays of all parts, one after the other."""
    made: dict[str, NDArray[Any]] = {
        "vertices": np.concatenate([part.points for part in parts]),
        "faces": joined_faces((part.faces for part in parts), [len(part.points) for part in parts]),
    }
    if len(textures) > 1:
        made["face_textures"] = np.concatenate([part.textures for part in parts])
    for name, width, blank in (("colors", 3, 1.0), ("uvs", 2, 0.0)):
        given = [getattr(part, name) for part in parts]
        kinds = {each[0] for each in given if each is not None}
        if not kinds:
            continue
        of = kinds.pop() if len(kinds) == 1 else "corner"
        if (name, of) == ("uvs", "face"):
            of = "corner"
        rows = [_by(of, part, each, width, blank) for part, each in zip(parts, given, strict=True)]
        made[f"{of}_{name}"] = np.concatenate(rows)
    return made


def _by(of: str, part: _Part, given: tuple[str, Floats] | None, width: int, blank: float) -> Floats:
    """Return the values of a part by vertex, face or corner; `blank` where it has none."""
    count = {"vertex": len(part.points), "face": len(part.faces), "corner": part.faces.size}[of]
    if given is None:
        return np.full((count, width), blank, np.float32)
    if given[0] == of:
        return given[1]
    if given[0] == "face":
        return np.repeat(given[1], 3, axis=0)
    rows: Floats = given[1][part.faces.reshape(-1).clip(0, max(len(given[1]) - 1, 0))]
    return rows
