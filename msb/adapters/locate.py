"""Find the file of a model in the output folder of a training.

This module uses only the names of files and folders, which is fast. `exporter.detect` detects the method
from the content of the file.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msb.asset import ASSET_SUFFIX, is_asset
from msb.base.files import is_file, is_folder, open_error
from msb.base.paths import given_path
from msb.errors import CheckpointError, InputError, MsbError
from msb.meshes import MESH_SUFFIXES
from msb.meshes.gltf import uses_gaussians
from msb.meshes.ply_table import read_ply_names
from msb.registry import METHODS, Method

Kind = Literal["torch", "ply", "mesh", "bundle", "other"]
TORCH_SUFFIXES = (".pt", ".ckpt", ".pth")
STATE_DICT = "point_cloud_state_dict.pt"
SPLATS = "point_cloud.ply"
# Vertex properties of a PLY with primitives: first 2DTS, then Gaussians, then SuperSplat's compressed
# Gaussians.
PRIMITIVE_PROPERTIES = {"x1", "rot_0", "packed_position"}
# File names of the meshes of 2DGS; cleaned meshes come first (hbb1/2d-gaussian-splatting: render.py).
FUSED = ("fuse_post.ply", "fuse_unbounded_post.ply", "fuse.ply", "fuse_unbounded.ply")


@dataclass(frozen=True)
class Place:
    """The place of a model: its file, and the output folder of its training."""

    # The file of the model. A model of several files has a main file.
    file: Path
    # The output folder, which is searched for configs and logs.
    root: Path
    # The kind of the file. A model of kind "bundle" has more files in the same folder. A file of kind "other"
    # is read by the adapter of its method only.
    kind: Kind
    # The path from the user: the file, its folder, or a higher folder. If the user gave a folder with a
    # single checkpoint subfolder, this path is the subfolder.
    given: Path

    @property
    def name(self) -> str:
        """The name for an asset of the model.

        This is the name of the output folder, or of the single file.
        """
        if self.given.is_dir():
            return self.given.resolve().name
        return self.file.stem if self.root == self.file.parent else self.root.resolve().name


def is_checkpoint(path: Path) -> bool:
    """Return whether `path` has the name of a torch file, or contains the output of a method."""
    if is_file(path):
        return path.suffix.lower() in TORCH_SUFFIXES or _is_declared(path)
    return _pick(path) is not None


def locate(path: str | os.PathLike[str]) -> Place:
    """Return the place of the model in `path`. If there are several iterations, the last one is used."""
    given = given_path(path)
    if given.suffix.lower() == ASSET_SUFFIX and os.path.lexists(given):
        text = "the path is already a .triasset; use msb convert to write another format"
        raise CheckpointError("CHECKPOINT_NOT_RECOGNISED", text, file=given)
    file, given = _model_file(given)
    suffix = file.suffix.lower()
    if any(in_bundle(file, method.bundle) for method in METHODS.values()):
        return Place(file, file.parent, "bundle", given)
    kind: Kind = "ply" if suffix == ".ply" else "mesh" if suffix in MESH_SUFFIXES else "torch"
    if kind == "torch" and suffix not in TORCH_SUFFIXES and _is_declared(file):
        kind = "other"
    return Place(file, _root(file), kind, given)


def _model_file(path: Path) -> tuple[Path, Path]:
    """Return the file of the model and the path that contains it: `path` itself, or the only checkpoint in
    `path`."""
    try:
        folder = path.is_dir()
    except (OSError, ValueError) as error:
        raise open_error(error, path, "file or folder") from error
    if not folder:
        if not os.path.lexists(path):
            raise InputError("FILE_NOT_FOUND", "the path does not exist", file=path)
        return path, path
    file = _pick(path)
    if file is None:
        # Search for a single checkpoint in the subfolders, then for a single file outside the usual folders.
        below = [sub for name in sorted(_list_names(path)) if (sub := path / name).is_dir() and _pick(sub)]
        if len(below) == 1:
            return _model_file(below[0])
        bare = [] if below else bare_models(path) or _find_named_meshes(path)
        if len(bare) == 1:
            return bare[0], path
        text = (
            "the folder is not the output folder of a known method; docs/export.md shows the folder layouts"
        )
        if several := below or bare:
            names = ", ".join(place.name for place in several[:8])
            text = f"the folder contains {len(several)} checkpoints ({names}); pass one of them"
        raise CheckpointError("CHECKPOINT_UNKNOWN", text, file=path)
    if not file.exists():
        text = f"{file.relative_to(path)} is missing: the last iteration has no model"
        raise CheckpointError("CHECKPOINT_FILE_MISSING", text, file=path, pointer=file.name)
    return file, path


def bare_models(folder: Path) -> list[Path]:
    """Return the torch files in a folder that has no method's layout.

    If there is exactly one torch file, it is used as the model.
    """
    return [folder / name for name in sorted(_list_names(folder)) if name.lower().endswith(TORCH_SUFFIXES)]


def _find_named_meshes(folder: Path) -> list[Path]:
    """Return the mesh files in a folder whose names belong to a method."""
    files = (folder / name for name in sorted(_list_names(folder)))
    return [file for file in files if any(is_named(method, file) for method in METHODS.values())]


def in_bundle(file: Path, names: tuple[str, ...]) -> bool:
    """Return whether `file` is the main file of a bundle with these file `names`."""
    return file.name in names[:1] and any((file.parent / name).exists() for name in names[1:])


def is_named(method: Method, file: Path) -> bool:
    """Return whether `file` has a name that `method` declares for its models."""
    names = (pattern.rpartition("/")[2] for pattern in method.files)
    return any(re.fullmatch(_to_expression(name), file.name) for name in names)


def _is_declared(file: Path) -> bool:
    """Return whether a method declares this file name, and the file is not a mesh file."""
    suffix = file.suffix.lower()
    return suffix not in MESH_SUFFIXES and any(is_named(method, file) for method in METHODS.values())


def _root(file: Path) -> Path:
    """Return the output folder that contains `file`, according to the names of the folders above the file."""
    above = [folder.name for folder in file.absolute().parents]
    if (
        len(above) > 2
        and above[1] in ("point_cloud", "train")
        and re.match(r"(iteration|ours)_\d+\Z", above[0])
    ):
        return file.absolute().parents[2]
    if len(above) > 1 and (above[0] in ("ckpt", "point_cloud", "glb", "mesh_ply") or _is_below(file)):
        return file.absolute().parents[1]
    return file.parent


def _is_below(file: Path) -> bool:
    """Return whether a method declares this name of folder and file, such as ``ckpt/{n}.ckpt``."""
    name = f"{file.absolute().parent.name}/{file.name}"
    below = (pattern for method in METHODS.values() for pattern in method.files if "/" in pattern)
    return any(re.fullmatch(_to_expression(pattern), name) for pattern in below)


def _pick(folder: Path) -> Path | None:
    """Return the file of the model in `folder`, or None if the folder has no method's layout.

    The file of the last iteration is returned even if it is missing on disk.
    """
    try:
        return next((file for rule in _RULES if (file := rule(folder)) is not None), None)
    except OSError as error:
        raise open_error(error, folder) from error


def _find_declared(folder: Path) -> Path | None:
    """Return the file with a name that a method declares, below the output folder or directly in `folder`."""
    for method in METHODS.values():
        if any((folder / name).exists() for name in method.bundle[1:]):
            return folder / method.bundle[0]
        for pattern in method.files:
            above, _, name = pattern.rpartition("/")
            places = [folder / above]
            if above and folder.name == above:
                places.append(folder)
            for place in places:
                if "*" in name:
                    matching = [
                        entry for entry in _list_names(place) if re.fullmatch(_to_expression(name), entry)
                    ]
                    file = place / matching[0] if len(matching) == 1 else None
                else:
                    file = _find_latest(place, _to_expression(name)) if "{n}" in name else place / name
                if file is not None and file.exists():
                    return file
    return None


def _to_expression(name: str) -> str:
    """Return the regular expression for a declared file name, with {n} for a number and * for any text."""
    return re.escape(name).replace(re.escape("{n}"), r"(\d+)").replace(re.escape("*"), "[^/]*")


def _find_iteration(folder: Path) -> Path | None:
    """Return the last file written by code of the 3DGS family: a state dict, a mesh of 2DGS, or Gaussians."""
    if re.match(r"iteration_\d+\Z", folder.name):
        latest: Path | None = folder
    else:
        inside = folder if folder.name == "point_cloud" else folder / "point_cloud"
        latest = _find_latest(inside, r"iteration_(\d+)")
    if latest is None:
        return None
    if (latest / STATE_DICT).exists():
        return latest / STATE_DICT
    if (latest / SPLATS).exists():
        return _find_fused(latest.parent.parent) or latest / SPLATS
    return latest / STATE_DICT


def _find_fused(folder: Path) -> Path | None:
    """Return the mesh that 2DGS extracted after its last iteration."""
    latest = _find_latest(folder / "train", r"ours_(\d+)")
    if latest is None:
        return None
    return next((latest / name for name in FUSED if (latest / name).exists()), None)


# Rules that find the file of a model in a folder. A rule returns the file or None. The first file that a rule
# finds is used.
_RULES: tuple[Callable[[Path], Path | None], ...] = (
    _find_declared,
    _find_iteration,
    lambda folder: folder / STATE_DICT if (folder / STATE_DICT).exists() else None,
    _find_fused,
    lambda folder: _find_latest(folder, r"chkpnt(\d+)\.pth"),
)


def _find_latest(folder: Path, pattern: str) -> Path | None:
    """Return the entry of `folder` that matches `pattern` and has the largest number."""
    numbered: dict[int, str] = {}
    for name in _list_names(folder):
        if (match := re.fullmatch(pattern, name)) and len(match[1]) < 19:
            numbered[int(match[1])] = name
    return folder / numbered[max(numbered)] if numbered else None


def _list_names(folder: Path) -> list[str]:
    try:
        return [path.name for path in folder.iterdir()]
    except (OSError, ValueError):  # ValueError: the path contains a NUL
        return []


def is_mesh_file(path: Path) -> bool:
    """Return whether msb reads `path` as a mesh file. All files except assets and trained models are mesh
    files."""
    return not (is_asset(path) or is_folder(path) or is_checkpoint(path) or _is_primitive_table(path))


def _is_primitive_table(path: Path) -> bool:
    """Return whether `path` is a PLY table of primitives (2DTS, Gaussians), or a GLB file of Gaussians."""
    if path.suffix.lower() != ".ply":
        return uses_gaussians(path)
    try:
        names, has_faces = read_ply_names(path)
    except MsbError:  # the mesh reader will report the error
        return False
    return not has_faces and bool(PRIMITIVE_PROPERTIES & set(names))
