"""Read the visible meshes of a USD stage as arrays. This module runs usd-core in a child process."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.meshes.polygons import join_faces, triangulate
from msb.meshes.usd_materials import UNBOUND, ImageUse, Material, MaterialReader, list_numbers, unite_textures

Floats = NDArray[np.float32]
# A domain ("constant", "vertex", "face" or "corner"), and values (n, width) for this domain.
Values = tuple[str, Floats]

# Maps the interpolation of a primvar to the domain of its values. Every other interpolation means one value
# per vertex.
_DOMAINS = {"uniform": "face", "faceVarying": "corner"}


@dataclass
class _PrimArrays:
    """The triangles of a mesh prim with their colours, UVs and textures.

    The fields `colors` (linear light) and `uvs` are None if the prim does not define them. The field
    `textures` (F,) contains image indices. The field `normals` is only used to explain duplicated vertices.
    """

    points: NDArray[Any]
    faces: NDArray[np.int64]
    colors: Values | None
    uvs: Values | None
    textures: NDArray[np.uint32]
    normals: Values | None = None


def read_stage(word: str, _: Arrays) -> tuple[Any, Arrays]:
    """Read the file `word`.

    This function runs in the child process. The function is a `Work` of `msb.base.children`.
    """
    from pxr import Sdf, Tf, Usd, UsdGeom

    try:
        layer = Sdf.Layer.FindOrOpen(word)
        # References to prims of the same file have an empty path.
        others = [path for path in layer.GetCompositionAssetDependencies() if path] if layer else []
        stage = Usd.Stage.Open(layer) if layer and not others else None
    except Tf.ErrorException:
        layer = None
    if layer is None:
        return {"refused": ("MESH_FILE_INVALID", "usd-core finds no stage in the file; export it again")}, {}
    if others:
        text = f"the stage refers to other files ({others[0][:80]}); merge them with usdcat --flatten"
        return {"refused": ("MESH_FILE_UNSUPPORTED", text)}, {}
    reader = _Reader(stage)
    try:
        parts = [reader.read_prim(UsdGeom.Mesh(prim)) for prim in reader.visible_meshes(stage)]
    except _Refused as refused:
        return {"refused": ("MESH_FILE_INVALID", str(refused))}, {}
    if not parts:
        return {"refused": ("MESH_FILE_INVALID", "the stage has no visible mesh")}, {}
    wraps, cutoff = unite_textures(list(reader.textured), reader.left_out)
    images = list(reader.images) if any(reader.images) else []
    data = {
        "up": "+z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "+y",
        "meters_per_unit": reader.meters_per_unit,
        "textures": [None if image is None else asdict(image) for image in images],
        "wraps": wraps,
        "cutoff": cutoff,
        "left_out": list(reader.left_out),
        "frame": str(layer.customLayerData.get("frame", ""))[:4000],
    }
    return data, _join_parts(parts, len(images))


class _Refused(Exception):
    """Error about an invalid stage, with the reason as its text."""


class _Reader:
    """Reader for the mesh prims of a USD stage.

    The field `images` maps each image to its index, in the order of their use. The key None means faces
    without an image. The field `textured` has the materials in use that have an image. The field `left_out`
    has the names of unread data.
    """

    def __init__(self, stage: Any) -> None:
        from pxr import Usd, UsdGeom

        self._time = Usd.TimeCode.EarliestTime()
        self._places = UsdGeom.XformCache(self._time)
        self.images: dict[ImageUse | None, int] = {}
        self.textured: dict[Material, None] = {}
        self.left_out: dict[str, None] = {}
        self._materials = MaterialReader(self._time, self.left_out)
        self.meters_per_unit = self._read_unit(stage)
        if stage.GetCompositionErrors():
            self.left_out["references that cannot be resolved"] = None

    def _read_unit(self, stage: Any) -> float:
        """Return the length of the stage's unit in metres. Without a valid unit, the length is 0.01."""
        from pxr import UsdGeom

        stored = float(UsdGeom.GetStageMetersPerUnit(stage))
        if np.isfinite(stored) and stored > 0:
            return stored
        default = float(UsdGeom.LinearUnits.centimeters)
        self.left_out[f"metersPerUnit ({stored:g} is not a length; {default:g} is used instead)"] = None
        return default

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
        # order (F, 3): indices into `corners`. polygon (F,): the polygon of each triangle.
        cut = triangulate(points, corners, counts)
        order, polygon = cut.order, cut.polygon
        self.left_out |= dict.fromkeys(cut.left_out)
        # Transform the vertices to world coordinates in metres. A mirroring transform and a left-handed
        # orientation each reverse the winding.
        matrix = np.array(self._places.GetLocalToWorldTransform(prim))
        matrix[:, :3] *= self.meters_per_unit
        is_left = mesh.GetOrientationAttr().Get(self._time) == UsdGeom.Tokens.leftHanded
        if not np.array_equal(matrix, np.eye(4)):
            with np.errstate(over="ignore", invalid="ignore"):
                points = points.astype(np.float64) @ matrix[:3, :3] + matrix[3, :3]
                is_left ^= np.linalg.det(matrix[:3, :3]) < 0
        if is_left:
            order = order[:, [0, 2, 1]]
        self._note_ignored(mesh)
        arrays = _PrimArrays(points, corners[order], None, None, np.zeros(len(order), np.uint32))
        arrays.normals = self._read_normals(mesh, order)
        shape = len(points), len(counts), len(corners)

        @cache
        def read(name: str, width: int) -> Values | None:
            return self._read_primvar(mesh, name, width, shape, order, polygon)

        self._add_look(arrays, self._read_materials(mesh, len(counts), polygon), read)
        return arrays

    def _add_look(
        self,
        arrays: _PrimArrays,
        materials: list[tuple[Material, NDArray[np.int64]]],
        read: Callable[[str, int], Values | None],
    ) -> None:
        """Add colours, UVs and textures to the `arrays` of a prim.

        The argument `materials` contains the materials of the prim, with the triangles of each material.
        `read(name, width)` returns the values of a primvar.
        """
        # Read the texture coordinates of the images. A material without texture coordinates loses its image.
        placed: dict[tuple[str, Any], Values | None] = {}
        uvs: list[tuple[NDArray[np.int64], Values | None]] = []
        for number, (material, faces) in enumerate(materials):
            if material.image is None:
                continue
            key = material.varname, material.transform
            if key not in placed:
                placed[key] = _place(read(material.varname, 2), material.transform)
            if placed[key] is None:
                self.left_out["textures without UVs"] = None
                materials[number] = UNBOUND, faces
            else:
                self.textured[material] = None
                uvs.append((faces, placed[key]))
        arrays.uvs = _combine(uvs, arrays, 2, 0.0)
        # Number the images, and collect the colours. Parts of a prim without a colour are white if the mesh
        # has images.
        colors = [(faces, _choose_color(material, read)) for material, faces in materials]
        for material, faces in materials:
            arrays.textures[faces] = self.images.setdefault(material.image, len(self.images))
        is_white = all(values is None or bool((values[1] == 1).all()) for _, values in colors)
        if not (uvs and is_white):
            arrays.colors = _combine(colors, arrays, 3, 1.0)

    def _read_array(self, attribute: Any, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the values of an attribute. Return an empty array if the attribute is not set."""
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
    ) -> Values | None:
        """Return the domain of the primvar `name` and its values (n, `width`), or None if it is not set.

        The argument `shape` has the numbers of vertices, polygons and polygon corners. The arguments `order`
        and `polygon` are the arrays of `read_prim`. Values of polygons become values of triangles. A primvar
        with a wrong number of values is ignored. For `displayColor`, a wrong number is an error.
        """
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            return None
        stored = primvar.ComputeFlattened(self._time)
        try:
            values = np.array([] if stored is None else stored, np.float32)
        except (TypeError, ValueError):  # Values of a text type cannot be converted.
            values = np.array([], np.float32)
        kind = str(primvar.GetInterpolation())
        domain = _DOMAINS.get(kind, "vertex")
        count = {"vertex": shape[0], "face": shape[1], "corner": shape[2]}[domain]
        if kind == "constant" and values.size == width:
            values = np.tile(values.reshape(1, width), (count, 1))
        if values.shape != (count, width) and name != "displayColor":
            self.left_out[f"invalid values of {name[:40]}"] = None
            return None
        if values.shape != (count, width):
            text = f"there are {len(values)} values of {name}, but {count} are needed"
            raise _Refused(f"{mesh.GetPrim().GetPath()}: {text}")
        if domain == "face":
            return domain, values[polygon]
        return domain, values[order.reshape(-1)] if domain == "corner" else values

    def _read_normals(self, mesh: Any, order: NDArray[np.int64]) -> Values | None:
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

    def _read_materials(
        self, mesh: Any, count: int, polygon: NDArray[np.int64]
    ) -> list[tuple[Material, NDArray[np.int64]]]:
        """Return the materials that the triangles of a mesh use. Each material has the indices of its
        triangles.

        The mesh has `count` polygons. The argument `polygon` (F,) is the polygon of each triangle.
        """
        from pxr import UsdGeom, UsdShade

        # Compute `owner` (P,), the material of each polygon. The material of a polygon comes from the subset
        # of the polygon. Without a subset, the material comes from the prim.
        numbers = {self._materials.find(mesh.GetPrim()): 0}
        owner = np.zeros(count, np.int64)
        kind = UsdShade.Tokens.materialBind
        for part in UsdGeom.Subset.GetGeomSubsets(mesh, UsdGeom.Tokens.face, kind):
            faces = self._read_array(part.GetIndicesAttr(), np.int64, (-1,))
            if faces.size and not 0 <= faces.min() <= faces.max() < count:
                raise _Refused(f"{part.GetPrim().GetPath()}: the subset selects faces that do not exist")
            owner[faces] = numbers.setdefault(self._materials.find(part.GetPrim()), len(numbers))
        # Group the triangles by material.
        owner = owner[polygon]
        by_material = np.argsort(owner, kind="stable")
        used, first = np.unique(owner[by_material], return_index=True)
        groups = np.split(by_material, first[1:])
        return [(list(numbers)[number], faces) for number, faces in zip(used, groups, strict=False)]

    def _note_ignored(self, mesh: Any) -> None:
        """Add the names of all unread data of a mesh prim to `left_out`."""
        from pxr import UsdGeom

        if mesh.GetNormalsAttr().HasAuthoredValue():
            self.left_out["normals"] = None
        if mesh.GetHoleIndicesAttr().HasAuthoredValue():
            self.left_out["holes"] = None
        opacity = UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance("displayOpacity")
        if opacity and any(value < 1 for value in list_numbers(opacity.Get(self._time))):
            self.left_out["opacity of vertices and faces"] = None
        if UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance("skel:jointIndices"):
            self.left_out["a skin"] = None
        scheme = mesh.GetSubdivisionSchemeAttr()
        if scheme.HasAuthoredValue() and scheme.Get(self._time) != UsdGeom.Tokens.none:
            self.left_out["subdivision"] = None
        if mesh.GetPointsAttr().GetNumTimeSamples() > 1:
            self.left_out["animation"] = None


def _choose_color(material: Material, read: Callable[[str, int], Values | None]) -> Values | None:
    """Return the colours that a material gives to a prim. Return None if the colours are white."""
    values = None if material.primvar is None else read(material.primvar, 3)
    if values is None and material.color is not None:
        return "constant", np.array([material.color], np.float32)
    return values


def _place(uvs: Values | None, transform: Any) -> Values | None:
    """Return texture coordinates after the transform of the image.

    Stored coordinates have v upwards, but the result has v downwards.
    """
    if uvs is None:
        return None
    domain, stored = uvs
    if transform is not None:
        matrix = np.array(transform)
        with np.errstate(over="ignore", invalid="ignore"):
            stored = (stored.astype(np.float64) @ matrix[:, :2].T + matrix[:, 2]).astype(np.float32)
    return domain, np.column_stack((stored[:, 0], 1 - stored[:, 1]))


def _combine(
    pieces: Sequence[tuple[NDArray[np.int64], Values | None]], part: _PrimArrays, width: int, blank: float
) -> Values | None:
    """Combine the values of the materials of a prim. Return None if no triangle has values.

    Each element of `pieces` has the triangle indices of a material. The element also has the values of this
    material for the whole prim.
    """
    given = [values for _, values in pieces]
    if all(values is None for values in given):
        return None
    if all(values is given[0] for values in given):
        assert given[0] is not None
        if given[0][0] == "constant":
            return "vertex", np.tile(given[0][1], (len(part.points), 1))
        return given[0]
    by_face = all(values is None or values[0] in ("constant", "face") for values in given)
    combined = np.full((len(part.faces), 1 if by_face else 3, width), blank, np.float32)
    for faces, values in pieces:
        if values is not None and by_face:
            combined[faces, 0] = values[1] if values[0] == "constant" else values[1][faces]
        elif values is not None:
            combined[faces] = _spread(values, part, faces)
    return "face" if by_face else "corner", combined.reshape(-1, width)


def _spread(values: Values, part: _PrimArrays, faces: Any) -> NDArray[Any]:
    """Return the values (n, 3, width) at the corners of the triangles `faces` (n,) of a part.

    Corners with an invalid index get an arbitrary value. Constant values have a single row and column.
    """
    domain, rows = values
    width = rows.shape[1]
    if domain == "constant":
        return rows.reshape(1, 1, width)
    if domain == "vertex":
        rows = rows if len(rows) else np.ones((1, width), np.float32)
        by_face: NDArray[Any] = rows[part.faces.clip(0, len(rows) - 1)]
    else:
        by_face = rows.reshape(-1, 1 if domain == "face" else 3, width)
    return np.asarray(by_face[faces])


def _join_parts(parts: list[_PrimArrays], textures: int) -> dict[str, NDArray[Any]]:
    """Return the concatenated arrays of all parts, under the names that `msb.meshes.usd` expects."""
    arrays: dict[str, NDArray[Any]] = {
        "vertices": np.concatenate([part.points for part in parts]),
        "faces": join_faces((part.faces for part in parts), [len(part.points) for part in parts]),
    }
    if textures > 1:
        arrays["face_textures"] = np.concatenate([part.textures for part in parts])
    if any(part.normals is not None for part in parts):
        rows = [_convert_domain("corner", part, part.normals, 3, 0.0) for part in parts]
        arrays["corner_normals"] = np.concatenate(rows)
    for name, width, blank in (("colors", 3, 1.0), ("uvs", 2, 0.0)):
        # Keep a domain that all parts have in common. Convert the values of different domains to corners.
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
    domain: str, part: _PrimArrays, values: Values | None, width: int, blank: float
) -> Floats:
    """Return the values (n, `width`) of a part, converted to `domain`. Return `blank` if the part has no
    values."""
    count = {"vertex": len(part.points), "face": len(part.faces), "corner": part.faces.size}[domain]
    if values is None:
        return np.full((count, width), blank, np.float32)
    if values[0] == domain:
        return values[1]
    at_corners = np.broadcast_to(_spread(values, part, slice(None)), (len(part.faces), 3, width))
    return at_corners.reshape(-1, width)
