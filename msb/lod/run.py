"""Levels of detail and a collision shape for a mesh, from reading to writing."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

import numpy as np

from msb.base.atomic import new_files
from msb.base.paths import given_path
from msb.delivery.surface_distance import Ints
from msb.errors import UsageError, about
from msb.lod.collision import SECONDS, Collision, make_collision
from msb.lod.names import name_parts, set_names
from msb.lod.opening import open_as_gltf
from msb.lod.options import INCLUDES_COLLISION, PLAIN, LodKeywords, LodOptions
from msb.lod.quality import draw, place_views, read_lit
from msb.lod.report import Level, Report, find_threshold
from msb.lod.rewriting import Placing, Rewriter
from msb.lod.scene import Scene, read_parts
from msb.lod.simplification import need_simplifier, simplify_scene
from msb.lod.textures import choose_factor
from msb.meshes.assets import fit_to_format
from msb.meshes.files import companion_files, write_mesh
from msb.meshes.formats import FORMATS, Style
from msb.meshes.gltf import Document, open_document
from msb.meshes.gltf_scene import read_scene
from msb.meshes.mesh import Mesh
from msb.meshes.normals import with_smooth_normals
from msb.meshes.source import Source
from msb.views import psnr_over_views

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False, repr=False)
class Lods:
    """An asset with its levels of detail and its collision shape, as GLB files in memory.

    Attributes
    ----------
    glb : bytes
        The whole asset, named and placed.
    levels : tuple of bytes
        The levels of detail, also those that are not usable.
    collision : bytes or None
        The collision shape; None also if it is a part of `glb`.
    report : Report
    shape : Collision or None
        The parts of the collision shape, in the coordinates of the file.
    name, source : str
        The name in the files, and the name of the original file.
    options : LodOptions
    """

    glb: bytes
    levels: tuple[bytes, ...]
    collision: bytes | None
    report: Report
    shape: Collision | None
    name: str
    source: str
    options: LodOptions

    def save(
        self, path: str | os.PathLike[str], *, overwrite: bool = False, unusable: bool = False
    ) -> Report:
        """Write the asset to `path`, and levels and collision beside it; return the report with the files.

        Levels are NAME_lod1, NAME_lod2, ..., the collision shape is NAME_collision, all or none. With
        `unusable`, levels that are not usable are written as well. For mujoco and isaac `path` is a folder.
        """
        target = given_path(path)
        if self.options.is_folder:
            from msb.lod.packages import write_package

            return write_package(self, target, overwrite)
        files: dict[Path, bytes] = {target: self.glb}
        kept: list[Path | None] = []
        for number, (glb, level) in enumerate(zip(self.levels, self.report.levels, strict=True), 1):
            is_kept = level.is_usable or unusable
            place = target if self.options.one_file else add_ending(target, f"_lod{number}")
            kept.append(place if is_kept else None)
            if is_kept and not self.options.one_file:
                files[place] = glb
        shape = None
        if self.shape is not None:
            shape = target if self.collision is None else add_ending(target, "_collision")
            files |= {} if self.collision is None else {shape: self.collision}
        encoded = {place: _encode(glb, place) for place, glb in files.items()}
        whole = {name: data for parts in encoded.values() for name, data in parts.items()}
        with new_files(list(whole), overwrite=overwrite) as streams:
            for stream, data in zip(streams, whole.values(), strict=True):
                stream.write(data)
        sizes = {place: sum(map(len, parts.values())) for place, parts in encoded.items()}
        return self.report.with_outputs(target, kept, shape, sizes)

    def __repr__(self) -> str:
        usable = sum(level.is_usable for level in self.report.levels)
        return f"<Lods of {self.report.faces:,} faces: {usable} of {len(self.levels)} levels usable>"


def add_ending(path: Path, ending: str) -> Path:
    """Return `path` with an ending of its stem."""
    return path.with_name(f"{path.stem}{ending}{path.suffix}")


def lod(
    asset: str | os.PathLike[str],
    *,
    name: str | None = None,
    device: str | None = None,
    progress: Progress | None = None,
    **options: Unpack[LodKeywords],
) -> Lods:
    """Make levels of detail and a collision shape for a mesh, which keeps its texture.

    A GLB or glTF file keeps everything: textures, texture coordinates, normals, tangents, materials, nodes,
    skins, animations, extras and names. Levels have a subset of its vertices.

    Parameters
    ----------
    asset : path-like
        A mesh file, or anything else that `msb.open` takes.
    name : str, optional
        The name of the asset in the files. Default: the name of the file.
    device : str, optional
        The OpenCL device that draws the views.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    **options
        The fields of `msb.lod.options.LodOptions`, which "Other Parameters" describes.

    Returns
    -------
    Lods

    Other Parameters
    ----------------
    lods : str or sequence of float, default (0.5, 0.25, 0.1)
        Shares or numbers of faces; "none" for none.
    collision : str, optional
        "mesh:N", "hulls:N" or "box".
    one_file : bool, default False
        Put all levels into `Lods.glb`.
    target : {"unity", "unreal", "godot", "blender", "web", "mujoco", "isaac"}, optional
        The program to write for.
    scale : float, optional
        The length of the unit in metres.
    floor, center : bool, default False
        Put the lowest point at height 0, and the middle of the bounding box at the origin.
    density, mass : float, optional
        In kg per cubic metre, or kg, for mujoco and isaac.
    label : str, optional
        The semantic label, for isaac.

    Raises
    ------
    UsageError
        USAGE: an argument is invalid. EXTRA_MISSING: a library is not installed.
    InputError, MeshFileError, MeshError, AssetError
        The asset cannot be read, or has no valid face.
    DeviceError
    """
    chosen = LodOptions(**options)
    if chosen.wanted or chosen.shape is not None:
        need_simplifier()
    path = given_path(asset)
    with about(path):
        return _Run(chosen, name or path.stem, device, progress or (lambda *_: None)).make(path)


@dataclass
class _Run:
    """One call of `lod`."""

    options: LodOptions
    name: str
    device: str | None
    progress: Progress

    def make(self, path: Path) -> Lods:
        options, steps = self.options, 3 + len(self.options.wanted)
        self.progress("reading", 0, steps)
        document, notes = open_as_gltf(path)
        scene = read_parts(document)
        self.progress("reducing faces", 1, steps)
        wanted = options.wanted
        shares = [level if level < 1 else level / scene.face_count for level in wanted]
        counts = [max(1, round(share * scene.face_count)) for share in shares]
        if any(share >= 1 for share in shares):
            text = f"--lods has {wanted[0]:.0f} faces, but the asset has {scene.face_count:,} only"
            raise UsageError("USAGE", text)
        faces = simplify_scene(scene, counts) if counts else []
        # The placing, from the bounding box of the asset as it is.
        placing = self._choose_placing(read_scene(document))
        whole = self._write(scene, None, 1.0, placing)[0]
        lit = read_lit(open_document(Source("whole.glb", whole)))
        cameras = place_views(lit)
        images = draw(lit, cameras, self.device) if counts else []
        # Write and measure the levels one after the other.
        levels: list[Level] = []
        files: list[bytes] = []
        for number, (share, rows) in enumerate(zip(shares, faces, strict=True), 1):
            self.progress("measuring levels", 1 + number, steps)
            glb, texture = self._write(scene, rows, share, placing, f"_LOD{number}")
            shown = read_lit(open_document(Source("level.glb", glb)))
            psnr = psnr_over_views(images, draw(shown, cameras, self.device))
            count = sum(map(len, rows))
            before = levels[-1].faces if levels else scene.face_count
            level = Level(None, share, count, len(glb), texture, psnr)
            levels.append(replace(level, why=_judge(level, before)))
            files.append(glb)
        # The collision shape, and the files that contain several things.
        shape = None
        if options.shape is not None:
            self.progress("collision", steps - 1, steps)
            points = lit.vertices.astype(np.float64)
            shape = make_collision(points, lit.faces, options.shape, SECONDS)
        is_inside = shape is not None and options.target in INCLUDES_COLLISION
        if options.one_file or is_inside:
            kept = [n for n, level in enumerate(levels) if level.is_usable] if options.one_file else []
            chosen = [faces[n] for n in kept]
            whole = self._write_joined(scene, chosen, [shares[n] for n in kept], placing, shape)
        made = shape.report if shape is not None else None
        notes += [made.why] if made is not None and made.why else []
        report = Report(None, scene.face_count, tuple(levels), made, tuple(notes))
        alone = None if shape is None or is_inside else self._write_collision(shape)
        self.progress("done", steps, steps)
        return Lods(whole, tuple(files), alone, report, shape, self.name, path.name, options)

    def _choose_placing(self, mesh: Mesh) -> Placing:
        """Return the scale, and the offset that puts the asset on the floor and into the middle."""
        used = mesh.vertices[np.unique(mesh.faces)].astype(np.float64)
        used = used[np.isfinite(used).all(axis=1)]
        scale = self.options.scale or 1.0
        low, high = scale * used.min(axis=0), scale * used.max(axis=0)
        offset = -(low + high) / 2 if self.options.center else np.zeros(3)
        if self.options.floor:
            offset[1] = -low[1]
        x, y, z = (float(value) for value in offset)
        return Placing(scale, (x, y, z))

    def _write(
        self, scene: Scene, faces: list[Ints] | None, share: float, placing: Placing, ending: str = ""
    ) -> tuple[bytes, tuple[int, int] | None]:
        """Return the GLB of a level, or of the whole asset without `faces`, and its largest texture."""
        writer = Rewriter(scene, plain=self.options.target in PLAIN)
        if faces is not None or writer.plain or scene.document.packed:
            writer.set_faces(faces or [part.faces for part in scene.parts])
        writer.shrink_images(1.0 if self.options.one_file else choose_factor(share))
        set_names(writer.root, self.name, ending)
        writer.place_scene(self.name + ending, placing)
        return writer.finish(), writer.texture

    def _write_joined(
        self,
        scene: Scene,
        levels: Sequence[list[Ints]],
        shares: list[float],
        placing: Placing,
        shape: Collision | None,
    ) -> bytes:
        """Return the GLB of the whole asset with levels and, where a program finds it, the shape."""
        writer = Rewriter(scene, plain=self.options.target in PLAIN)
        if writer.plain or scene.document.packed:
            writer.set_faces([part.faces for part in scene.parts])
        writer.shrink_images(1.0)
        set_names(writer.root, self.name)
        shown = [node["name"] for node in writer.root["nodes"] if "mesh" in node]
        if self.options.one_file:
            added = [writer.add_level(faces, f"_LOD{number}") for number, faces in enumerate(levels, 1)]
            is_alternative = self.options.target in (None, "web")
            writer.group_levels(self.name, added, shares if is_alternative else None)
        writer.place_scene(self.name, placing)
        if shape is not None and self.options.target in INCLUDES_COLLISION:
            # Unreal matches a shape with the mesh whose name it contains.
            is_single = self.options.target == "unreal" and len(shown) == 1
            name = shown[0] if is_single else self.name
            writer.add_shapes(self._name_shapes(shape, name), writer.default_scene())
        return writer.finish()

    def _name_shapes(self, shape: Collision, name: str) -> list[tuple[str, np.ndarray, Ints]]:
        names = name_parts(name, len(shape.parts), shape.report.kind, self.options.target)
        return [(word, *part) for word, part in zip(names, shape.parts, strict=True)]

    def _write_collision(self, shape: Collision) -> bytes:
        """Return the GLB of a collision shape: a node for each part."""
        root = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"name": self.name}], "nodes": []}
        writer = Rewriter(Scene(Document(Source("empty", b""), root, {}), ()))
        writer.add_shapes(self._name_shapes(shape, self.name), writer.default_scene())
        return writer.finish()


def _judge(level: Level, before: int) -> str | None:
    """Return the reason why a level is not usable, or None. `before` is the number of faces before it."""
    if level.faces >= before:
        return "no face could be removed"
    least = find_threshold(level.share)
    if level.psnr < least:
        return f"its images have {level.psnr:.1f} dB to the whole asset; {least:.0f} dB are needed"
    return None


def _encode(glb: bytes, place: Path) -> dict[Path, bytes]:
    """Return the files of a GLB in the format of the suffix of `place`: the file and its companions."""
    suffix = place.suffix.lower()
    if suffix == ".glb":
        return {place: glb}
    mesh = fit_to_format(read_scene(open_document(Source("asset.glb", glb))), suffix)
    if "normals" in FORMATS[suffix].keeps:
        mesh = with_smooth_normals(mesh)
    style = Style(stem=place.stem, is_lit=True)
    file = io.BytesIO()
    write_mesh(mesh, file, suffix=suffix, style=style)
    return {**companion_files(mesh, place, style), place: file.getvalue()}
