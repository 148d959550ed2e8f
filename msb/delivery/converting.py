"""The function `msb.convert`, which converts a single model. The command `msb convert` calls the same code
for each input."""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from msb.adapters.locate import is_mesh_file
from msb.adapters.official import write_official
from msb.api.opening import describe_opened, open
from msb.asset import ASSET_SUFFIX, Asset, write_asset
from msb.asset.frame import Frame, frame_of, make_frame, nearest_axis, parse_up, with_frame
from msb.asset.look import up_axis
from msb.asset.origin import world_positions
from msb.asset.writer import Form
from msb.base.atomic import check_new
from msb.base.paths import given_path, real_place
from msb.delivery import Engine
from msb.delivery.saving import check_choice, choose_style, output_suffix
from msb.delivery.web_quality import ImageLoss
from msb.errors import UsageError, about
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh, fit_to_format, mesh_from_asset, without_bad_faces
from msb.meshes.files import write_whole
from msb.meshes.formats import FORMATS, Color, Picture
from msb.meshes.image_files import describe_counts
from msb.meshes.losses import (
    describe_placement,
    describe_up_axis,
    list_dropped_features,
    list_engine_losses,
    list_losses,
)
from msb.render.options import UpDirection
from msb.scenes.framing import find_framing

Stage = Callable[[str], AbstractContextManager[None]]
_SPLAT_WRITERS = {
    ".spz": "convert this PLY with npx @playcanvas/splat-transform in.ply out.spz",
    ".sog": "convert this PLY with npx @playcanvas/splat-transform in.ply out.sog",
    ".splat": "export .splat from this PLY in SuperSplat",
}
"""Suffix of a format of Gaussians that is read only -> a way to write this format."""


@dataclass(frozen=True)
class Converted:
    """The result of `convert`.

    Attributes
    ----------
    path : Path
        The written file.
    contents : tuple of str
        The contents of the file: numbers of vertices and faces, kinds of colours, the rotation, and measured
        quality.
    notes : tuple of str
        Warnings about the input, and a list of data that the file does not contain.
    """

    path: Path
    contents: tuple[str, ...]
    notes: tuple[str, ...]


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    form: Form | None = None,
    up: UpDirection | None = None,
    scale: float | None = None,
    known_distance: tuple[str, str, str] | None = None,
    floor: bool = False,
    color: Color | None = None,
    texture: Picture | None = None,
    engine: Engine | None = None,
    official: bool = False,
) -> Converted:
    """Convert a model or mesh. The suffix of `target` sets the format, as in the command `msb convert`.

    Vertices and faces keep their order and colours as far as the format allows. A mesh file keeps the
    precision of its coordinates, unless the format of the output has only float32. If an error occurs, no
    file is written.

    Parameters
    ----------
    source : path-like
        A `.triasset`, a checkpoint or a mesh file. An asset in memory is written by `msb.save`.
    target : path-like
        The output.
    overwrite : bool
        Replace an existing file. The file of `source` is never replaced.
    form : {"packed", "folder"}, optional
        The form of a `.triasset`. Default: packed.
    up : str, optional
        The direction that points up in `source`, an axis such as "-y" or "X,Y,Z". A mesh file is rotated so
        that +y points up. A `.triasset` records the direction instead. The default is no rotation. For `.glb`
        and USD, the default is the up axis of `source`, if known.
    scale : float, optional
        The length of the unit of `source` in metres. With `scale`, mesh files are written in metres.
    known_distance : (str, str, str), optional
        In place of `scale`: two points "X,Y,Z" of `source` and their distance, such as "1.2m".
    floor : bool
        Put the lowest point at height 0. Far outliers are ignored.
    color, texture, engine : str, optional
        As in `msb.save`.
    official : bool
        Write the same file as the method's official exporter.

    Returns
    -------
    Converted

    Raises
    ------
    UsageError
        `USAGE`: the suffix or an option is invalid, or options cannot be combined. `OUTPUT_EXISTS`: the file
        exists, and `overwrite` is false. `EXTRA_MISSING`: an optional package is not installed.
    InputError, CheckpointError, MeshFileError, MeshError, AssetError
        `source` cannot be read.
    OutputError
        `OUTPUT_UNWRITABLE` or `OUTPUT_FORMAT_LIMIT`.
    Unsupported
        The method has no static colours, or no official exporter.

    Examples
    --------
    >>> import msb
    >>> done = msb.convert("data_stubs/checkpoint", "out/example/upright.glb", overwrite=True)
    >>> done.contents[:3]
    ('2,582 vertices', '5,159 faces', 'vertex colours')
    """
    place, output_path = given_path(source), given_path(target)
    if form is not None:
        check_choice("form", form, get_args(Form))
    frame = make_frame(up, scale, known_distance)
    if official and (floor or (form, frame, color, texture, engine) != (None,) * 5):
        text = (
            "form, up, scale, floor, color, texture and engine cannot be combined with official; pass "
            "only official"
        )
        raise UsageError("USAGE", text)
    conversion = Conversion(
        form, frame, color, texture, engine, floor=floor, official=official, overwrite=overwrite
    )
    conversion.check_target(output_path)
    if real_place(place) == real_place(output_path):
        raise UsageError("USAGE", "this path is an input; write the output to another file", file=output_path)
    if official and not overwrite:  # only the official writer does not check this
        check_new(output_path)
    warnings: list[str] = []
    done = replace(conversion, note=warnings.append).run(place, output_path)
    return replace(done, notes=(*warnings, *done.notes))


@contextmanager
def _silent(_text: str) -> Iterator[None]:
    yield


@dataclass(frozen=True)
class Conversion:
    """The options of a conversion, with hooks for checks and warnings.

    `stage` displays the current stage of the work.
    """

    form: Form | None = None
    frame: Frame | None = None
    color: Color | None = None
    texture: Picture | None = None
    engine: Engine | None = None
    floor: bool = False
    official: bool = False
    overwrite: bool = False
    stage: Stage = _silent
    # A function that checks whether a file beside the mesh, such as a texture, may be written.
    check_free: Callable[[Path], None] = lambda path: None
    # A function that is called immediately with each warning about the input.
    note: Callable[[str], None] = lambda text: None

    def check_target(self, target: Path) -> None:
        """Check the suffix of an output path.

        Also check that the format stores the data that the options affect.
        """
        suffix = target.suffix.lower()
        if suffix in _SPLAT_WRITERS:
            remedy = _SPLAT_WRITERS[suffix]
            text = f"{suffix} files are not written; write a .ply with --official, then {remedy}"
            raise UsageError("USAGE", text)
        keeps = FORMATS[suffix].keeps if suffix in FORMATS else ("textures",)
        if self.texture is not None and "textures" not in keeps:
            raise UsageError(
                "USAGE", f"--texture needs a format that stores textures, which {suffix} does not"
            )
        if self.color is not None and not keeps:
            raise UsageError("USAGE", f"--color needs a format that stores colours, which {suffix} does not")
        if not self.official:
            output_suffix(target, "OUT")

    def run(self, source: Path, target: Path) -> Converted:
        """Convert one input. The function `check_target` must have checked the output path."""
        if self.official:
            return self._write_official(source, target)
        if target.suffix.lower() == ASSET_SUFFIX:
            if (self.color, self.texture, self.engine) != (None,) * 3:
                text = (
                    "--color, --texture and --for apply to mesh files only; a .triasset stores the data "
                    "of IN unchanged"
                )
                raise UsageError("USAGE", text)
            return self._write_asset(source, target)
        if self.form is not None:
            text = f"--form applies to .triasset only, but {target.name} is a mesh file"
            raise UsageError("USAGE", text)
        return self._write_mesh(source, target)

    def _open(self, source: Path) -> Asset:
        with self.stage(f"reading {source.name}"):
            asset = open(source)
        for text in describe_opened(source, asset):
            self.note(text)
        return asset

    def _write_asset(self, source: Path, target: Path) -> Converted:
        asset = self._open(source)
        if self.frame is not None or self.floor:
            asset = with_frame(asset, self._choose_frame(asset, frame_of(asset.manifest)))
        with self.stage(f"writing {target.name}"):
            write_asset(asset, target, self.form or "packed", overwrite=self.overwrite)
        return Converted(target, asset.manifest.counts, ())

    def _choose_frame(self, asset: Asset, known: Frame | None) -> Frame:
        """Return the coordinate frame of `asset` or of a mesh file, with the given changes and the floor."""
        frame, given = known or Frame(), self.frame or Frame()
        frame = replace(frame, up=given.up or frame.up)
        if given.meters_per_unit is not None:
            frame = replace(frame, meters_per_unit=given.meters_per_unit, source=given.source)
        if self.floor:
            up = frame.up or parse_up(up_axis(asset))
            faces, framed = asset.buffers["indices"], find_framing(asset).framed
            faces = faces if framed is None else faces[framed]
            heights = world_positions(asset).astype(np.float64) @ np.array(up)
            frame = replace(frame, up=up, floor=float(heights[np.unique(faces)].min()))
        return frame

    def _write_official(self, source: Path, target: Path) -> Converted:
        asset = self._open(source)
        with self.stage(f"writing {target.name}"), about(source):
            write_official(asset, target)
        return Converted(
            target, (f"written in the form of the official exporter of {asset.manifest.method}",), ()
        )

    def _write_mesh(self, source: Path, target: Path) -> Converted:
        suffix, asset = output_suffix(target, "OUT"), None
        if is_mesh_file(source):
            with self.stage(f"reading {source.name}"):
                mesh = read_mesh(source)  # an asset would round the coordinates to float32
            ignored, known = list(mesh.left_out), True
            mesh, bad = without_bad_faces(mesh)
            if bad:
                self.note(
                    f"{source}: {bad:,} faces have coordinates that are not finite; these faces are omitted"
                )
        else:
            asset = self._open(source)
            mesh, ignored = mesh_from_asset(asset), list_dropped_features(asset)
            known = asset.manifest.coordinate_frame.known_up is not None
        is_upright = False
        if self.frame is not None or self.floor:
            frame = self._choose_frame(asset or asset_from_mesh(mesh), mesh.frame)
            axis = mesh.up if frame.up is None else nearest_axis(frame.up)
            is_upright = self.frame is not None and self.frame.up is not None
            mesh, known = replace(mesh, frame=frame, up=axis), known or is_upright
        with self.stage(f"choosing the encoding of {target.name}"), about(source):
            style, quality = choose_style(
                mesh, target, asset, color=self.color, texture=self.texture, engine=self.engine
            )
        # Errors about coordinates and indices name the source file, not the target file.
        with self.stage(f"writing {target.name}"), about(source):
            storable = fit_to_format(mesh, suffix, is_upright=is_upright)
            write_whole(storable, target, style, overwrite=self.overwrite, check_companion=self.check_free)
        changes = [f"rotated upright (the up axis was {mesh.up})"] if mesh.up != storable.up else []
        unit = None if mesh.frame is None else mesh.frame.meters_per_unit
        changes += [f"scaled to metres (one unit was {unit:g} m)"] if unit is not None else []
        changes += ["lowered to the floor"] if self.floor else []
        if mesh.meters_per_unit not in (None, 1.0):
            changes.append(f"scaled to metres (one unit was {mesh.meters_per_unit:g} m)")
        contents = (*_list_contents(storable, suffix), *changes, *([quality] if quality else []))
        loss = ""
        if mesh.textures and not storable.textures and storable.vertex_colors is not None:
            loss = ImageLoss.of(mesh, asset).describe(replace(storable, vertices=mesh.vertices))
        notes = [*list_losses(mesh, storable, suffix, ignored, loss)]
        notes += list_engine_losses(storable, self.engine) if self.engine else ()
        notes += describe_placement(storable, suffix)
        notes += describe_up_axis(storable if is_upright else mesh, suffix, known=known)
        return Converted(target, contents, tuple(f"{target}: {text}" for text in notes))


def _list_contents(mesh: Mesh, suffix: str) -> list[str]:
    """Return the numbers of vertices and faces, and the kinds of colours in the file."""
    form = FORMATS[suffix]
    counts = [f"{len(mesh.vertices):,} vertices", f"{len(mesh.faces):,} faces"]
    if mesh.textures and form.list_stored:
        return [*counts, *form.list_stored(mesh)]
    colors = [
        key.replace("_colors", " colours").replace("_uvs", " UVs")
        for key in form.keeps
        if key not in ("normals", "textures", "collision") and getattr(mesh, key) is not None
    ]
    colors += describe_counts(len(mesh.textures), 0)
    return [*counts, *(colors or ["no colours"])]
