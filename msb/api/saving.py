"""From an asset to a file of any format that its suffix names."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msb.asset import ASSET_SUFFIX, Asset, write_asset
from msb.asset.arguments import AN_ASSET, check_type
from msb.asset.writer import FORMS
from msb.base.paths import given_path
from msb.errors import UsageError, about, shorten
from msb.meshes.assets import as_held, mesh_from_asset
from msb.meshes.files import write_whole
from msb.meshes.formats import written_suffixes

if TYPE_CHECKING:
    from msb.asset.progress import Progress
    from msb.asset.writer import Form


def save(
    asset: Asset,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    form: Form = "packed",
    progress: Progress | None = None,
) -> None:
    """Write `asset` in the format that the suffix of `path` names, whole or not at all.

    Parameters
    ----------
    asset : Asset
    path : path-like
        `.triasset` takes the asset as it is; `.glb`, `.ply` and the other mesh formats that are written take
        its standard-tier mesh, as `msb convert` writes it: opaque, with static colours (STL has none) and, in
        `.glb` and `.obj`, textures; the latter with `.mtl` and images beside it. `.glb` is upright, as glTF
        says, where it is known what is up.
    overwrite : bool
        Replace what is there. A device or pipe is written through in any case.
    form : {"packed", "folder"}
        The form of a `.triasset`: a single file (ZIP of stored, 64-byte aligned members) or a folder.
    progress : callable, optional
        Called as ``progress("writing", done, total)``, in bytes, while a `.triasset` is written.

    Raises
    ------
    UsageError
        `USAGE`: no such suffix or form, or an argument of another type. `OUTPUT_EXISTS`.
    OutputError
        `OUTPUT_UNWRITABLE` if the place cannot be written; nothing is left behind then. For mesh files also
        `OUTPUT_FORMAT_LIMIT`.
    AssetError
        `load` would refuse the asset: its manifest was changed by hand, or buffers do not have its shapes.
    Unsupported
        `UNSUPPORTED_TIER`: the method has no static colours, which mesh files need.
    """
    check_type("asset", asset, Asset, AN_ASSET)
    if form not in FORMS:
        text = f'there is no form "{shorten(str(form), 40)}"; there are {", ".join(FORMS)}'
        raise UsageError("USAGE", text)
    target = given_path(path)
    suffix = output_suffix(target)
    if suffix == ASSET_SUFFIX:
        write_asset(asset, target, form, overwrite=overwrite, progress=progress)
        return
    if form != "packed":
        raise UsageError("USAGE", f"form is for {ASSET_SUFFIX}; {target.name} is a mesh file", file=target)
    with about(asset.path):
        write_whole(as_held(mesh_from_asset(asset), suffix), target, overwrite=overwrite)


def output_suffix(path: Path, name: str = "the output") -> str:
    """Return the suffix of `path` in lower case, if it is one of a format that can be written."""
    return checked_ending(path, name, (ASSET_SUFFIX, *written_suffixes()))


_MAKERS = {
    "a page": ("msb web", (".html", ".htm")),
    "pictures": ("msb render", (".png", ".npy", ".exr")),
    "a film": ("msb render --film", (".mp4", ".gif")),
    "a figure": ("msb view --figure", (".svg", ".pdf")),
    "offending elements": ("msb audit --elements", (".vtp", ".csv", ".npz")),
}
"""What has none of the endings of models -> the command that writes it, and its endings."""
_OTHER_MODELS = (".gltf", ".fbx", ".usd", ".usda", ".usdc", ".usdz", ".dae", ".blend", ".abc", ".3ds", ".x3d")


def checked_ending(path: Path, name: str, known: Sequence[str]) -> str:
    """Return the ending of `path` in lower case, if it is one of `known`."""
    suffix = path.suffix.lower()
    if suffix in known:
        return suffix
    makers = {
        "a mesh file": ("msb convert", written_suffixes()),
        "an asset": ("msb export or msb convert", (ASSET_SUFFIX,)),
        **_MAKERS,
    }
    hint = next((f"; for {what}: {by}" for what, (by, endings) in makers.items() if suffix in endings), "")
    if suffix in _OTHER_MODELS:
        hint = "; .glb is opened by Blender and by every engine"
        hint += "" if ".glb" in known else ": msb convert writes it"
    one_of = "one of " if len(known) > 1 else ""
    raise UsageError("USAGE", f'{name} is "{path.name}"; it must end in {one_of}{", ".join(known)}{hint}')
