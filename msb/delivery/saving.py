"""From an asset to a file of any format that its suffix names."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from msb.asset import ASSET_SUFFIX, Asset, write_asset
from msb.asset.arguments import AN_ASSET, check_type
from msb.asset.progress import Progress
from msb.asset.writer import FORMS, Form
from msb.base.files import is_folder
from msb.base.paths import given_path
from msb.delivery import Engine
from msb.errors import UsageError, about, shorten
from msb.meshes import Mesh
from msb.meshes.assets import as_held, mesh_from_asset
from msb.meshes.files import write_whole
from msb.meshes.formats import Color, Picture, Style, written_suffixes


def save(
    asset: Asset,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    form: Form = "packed",
    color: Color | None = None,
    texture: Picture | None = None,
    engine: Engine | None = None,
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
    color : {"linear", "srgb"}, optional
        Of a mesh file: what its vertex colours are. Default: linear light in `.glb`, as glTF says, else sRGB.
    texture : {"png", "jpeg", "webp"}, optional
        Of `.glb` and `.obj`: what textures are packed as. Default: PNG, which loses nothing.
    engine : {"unreal", "unity", "godot", "blender", "three", "web"}, optional
        Write the `.glb` that it opens with no setting touched. For the web: compressed, with WebP, rows in
        another order, and as coarse as 50 dB allow, which pictures of the asset say; this wants the extra
        `compressed`. For all others what is written without this. It knows `color` and `texture` itself.
    progress : callable, optional
        Called as ``progress("writing", done, total)``, in bytes, while a `.triasset` is written.

    Raises
    ------
    UsageError
        `USAGE`: no such suffix, form or engine, an argument of another type, or options that do not go
        together. `OUTPUT_EXISTS`. `EXTRA_MISSING`.
    OutputError
        `OUTPUT_UNWRITABLE` if the place cannot be written; nothing is left behind then. For mesh files also
        `OUTPUT_FORMAT_LIMIT`.
    AssetError
        `load` would refuse the asset: its manifest was changed by hand, or buffers do not have its shapes.
    Unsupported
        `UNSUPPORTED_TIER`: the method has no static colours, which mesh files need.
    """
    check_type("asset", asset, Asset, AN_ASSET)
    _check_one_of("form", form, FORMS)
    target = given_path(path)
    suffix = output_suffix(target)
    if suffix == ASSET_SUFFIX:
        if (color, texture, engine) != (None,) * 3:
            text = f"color, texture and engine are for mesh files; {target.name} keeps what is stored"
            raise UsageError("USAGE", text, file=target)
        write_asset(asset, target, form, overwrite=overwrite, progress=progress)
        return
    if form != "packed":
        raise UsageError("USAGE", f"form is for {ASSET_SUFFIX}; {target.name} is a mesh file", file=target)
    with about(asset.path):
        mesh = mesh_from_asset(asset)
        style, _ = style_for(mesh, target, asset, color=color, texture=texture, engine=engine)
        write_whole(as_held(mesh, suffix), target, style, overwrite=overwrite)


def style_for(
    mesh: Mesh,
    target: Path,
    asset: Asset | None = None,
    *,
    color: Color | None = None,
    texture: Picture | None = None,
    engine: Engine | None = None,
) -> tuple[Style, str | None]:
    """Return how `mesh`, that of `asset` or of a file, is written to `target` by these options.

    Of a file for the web also how far its pictures are from those of the mesh.

    Raises
    ------
    UsageError
        `USAGE`: there is no such option, or they do not go together.
    """
    for name, value, known in (
        ("color", color, Color),
        ("texture", texture, Picture),
        ("engine", engine, Engine),
    ):
        if value is not None:
            _check_one_of(name, value, get_args(known))
    if engine and (color or texture):
        raise UsageError("USAGE", "color and texture do not go with an engine, which knows them")
    if engine and target.suffix.lower() != ".glb":
        text = f"a file for an engine is a .glb, which every engine opens; the output is {target.name}"
        raise UsageError("USAGE", text)
    if engine != "web":
        return Style(color, texture or "png"), None
    from msb.delivery.pictures import Pictures, web_style

    return web_style(Pictures.of(mesh, asset))


def _check_one_of(name: str, value: Any, known: Sequence[str]) -> None:
    if value not in known:
        text = f'there is no {name} "{shorten(str(value), 40)}"; there are {", ".join(known)}'
        raise UsageError("USAGE", text)


# What has none of the endings of models -> the command that writes it, and its endings.
_MAKERS = {
    "a page": ("msb web", (".html", ".htm")),
    "pictures": ("msb render", (".png", ".npy", ".exr")),
    "a film": ("msb render --film", (".mp4", ".gif")),
    "a figure": ("msb view --figure", (".svg", ".pdf")),
    "offending elements": ("msb audit --elements", (".vtp", ".csv", ".npz")),
}
_OTHER_MODELS = (".gltf", ".fbx", ".usd", ".usda", ".usdc", ".usdz", ".dae", ".blend", ".abc", ".3ds", ".x3d")


def output_suffix(path: Path, name: str = "the output") -> str:
    """Return the suffix of `path` in lower case, if it is one of a format that can be written."""
    suffix, known = path.suffix.lower(), (ASSET_SUFFIX, *written_suffixes())
    if suffix in known:
        return suffix
    hint = next((f"; for {what}: {by}" for what, (by, endings) in _MAKERS.items() if suffix in endings), "")
    if suffix in _OTHER_MODELS:
        hint = "; .glb is opened by Blender and by every engine"
    is_one = f'is "{path.name}"' + (", a folder" if is_folder(path) else "")
    raise UsageError("USAGE", f"{name} {is_one}; it must end in one of {', '.join(known)}{hint}")
