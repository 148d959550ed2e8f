"""Writes an asset to a file. The suffix of the file sets the format."""

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
from msb.meshes.assets import fit_to_format, mesh_from_asset
from msb.meshes.files import write_whole
from msb.meshes.formats import Color, Picture, Style, list_written_suffixes


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
    """Write `asset` to a file. The suffix of `path` sets the format. If an error occurs, no file is written.

    Parameters
    ----------
    asset : Asset
    path : path-like
        `.triasset` stores the asset unchanged. `.glb`, `.ply` and other mesh formats store the opaque
        standard-tier mesh of the asset. The file has the static colours of the mesh (except in STL). A `.glb`
        or `.obj` also contains textures. An `.obj` file is written with an `.mtl` file and images. If the up
        axis of the asset is known, a `.glb` is rotated so that +y points up, as glTF specifies.
    overwrite : bool
        Replace an existing file. Devices and pipes are always accepted.
    form : {"packed", "folder"}
        The form of a `.triasset`: a single file (ZIP with uncompressed, 64-byte aligned members) or a folder.
    color : {"linear", "srgb"}, optional
        The colour space of vertex colours in a mesh file. Default: linear in `.glb`, as glTF specifies, else
        sRGB.
    texture : {"png", "jpeg", "webp"}, optional
        The image format of textures in `.glb` and `.obj`. Default: PNG, which is lossless.
    engine : {"unreal", "unity", "godot", "blender", "three", "web"}, optional
        Write a `.glb` that this program opens correctly without import settings. For "web", the file is the
        smallest compressed file with a PSNR of at least 50 dB in images of the asset. Textures are stored as
        WebP, and faces are reordered. This option needs the extra `compressed`. For other programs, the file
        is the same as without this option. `engine` cannot be combined with `color` or `texture`.
    progress : callable, optional
        Called as ``progress("writing", done, total)``, in bytes, while a `.triasset` is written.

    Raises
    ------
    UsageError
        `USAGE`: the suffix or an argument is invalid, or options cannot be combined. `OUTPUT_EXISTS`: the
        file exists, and `overwrite` is false. `EXTRA_MISSING`: an optional package is not installed.
    OutputError
        `OUTPUT_UNWRITABLE`: the path cannot be written. `OUTPUT_FORMAT_LIMIT`: the mesh exceeds a limit of
        the format.
    AssetError
        The asset is invalid, for example because its manifest was changed by hand.
    Unsupported
        `UNSUPPORTED_TIER`: the method has no static colours, which mesh files need.
    """
    check_type("asset", asset, Asset, AN_ASSET)
    check_choice("form", form, FORMS)
    target = given_path(path)
    suffix = output_suffix(target)
    if suffix == ASSET_SUFFIX:
        if (color, texture, engine) != (None,) * 3:
            text = (
                f"color, texture and engine apply to mesh files only, but {target.name} is stored unchanged"
            )
            raise UsageError("USAGE", text, file=target)
        write_asset(asset, target, form, overwrite=overwrite, progress=progress)
        return
    if form != "packed":
        raise UsageError(
            "USAGE", f"form applies to {ASSET_SUFFIX} only, but {target.name} is a mesh file", file=target
        )
    with about(asset.path):
        mesh = mesh_from_asset(asset)
        style, _ = choose_style(mesh, target, asset, color=color, texture=texture, engine=engine)
        write_whole(fit_to_format(mesh, suffix), target, style, overwrite=overwrite)


def choose_style(
    mesh: Mesh,
    target: Path,
    asset: Asset | None = None,
    *,
    color: Color | None = None,
    texture: Picture | None = None,
    engine: Engine | None = None,
) -> tuple[Style, str | None]:
    """Return the output style for writing `mesh` to `target`.

    Also return a text about the measured image quality (web only). `mesh` is the mesh of `asset`, or the mesh
    of a mesh file. The options are the same as in `save`.

    Raises
    ------
    UsageError
        `USAGE`: an option is invalid, or options cannot be combined.
    """
    for name, value, known in (
        ("color", color, Color),
        ("texture", texture, Picture),
        ("engine", engine, Engine),
    ):
        if value is not None:
            check_choice(name, value, get_args(known))
    if engine and (color or texture):
        raise UsageError("USAGE", "color and texture cannot be combined with engine, which sets them")
    if engine and target.suffix.lower() != ".glb":
        text = f"engine needs an output with the suffix .glb, not {target.name}"
        raise UsageError("USAGE", text)
    if engine != "web":
        return Style(color, texture or "png"), None
    from msb.delivery.web_quality import ImageLoss, web_style

    return web_style(ImageLoss.of(mesh, asset))


def check_choice(name: str, value: Any, known: Sequence[str]) -> None:
    """Raise USAGE unless `value` is an allowed value of the option."""
    if value not in known:
        text = f'{name} "{shorten(str(value), 40)}" does not exist; choose from {", ".join(known)}'
        raise UsageError("USAGE", text)


# The commands that write pages, images, films and other outputs, with the suffixes of these files.
_OTHER_OUTPUTS = {
    "a page": ("msb web", (".html", ".htm")),
    "images": ("msb render", (".png", ".npy", ".exr")),
    "a film": ("msb render --film", (".mp4", ".gif")),
    "a figure": ("msb view --figure", (".svg", ".pdf")),
    "offending elements": ("msb audit --elements", (".vtp", ".csv", ".npz")),
}
# Suffixes of model formats that save and convert cannot write.
_OTHER_MODELS = (".gltf", ".fbx", ".usd", ".usda", ".usdc", ".usdz", ".dae", ".blend", ".abc", ".3ds", ".x3d")


def output_suffix(path: Path, name: str = "the output") -> str:
    """Return the suffix of `path` in lower case if the format can be written, else raise USAGE.

    Error messages call the path `name`. If no model can be written in the format, the message names the
    command that writes such files.
    """
    suffix, known = path.suffix.lower(), (ASSET_SUFFIX, *list_written_suffixes())
    if suffix in known:
        return suffix
    hint = next(
        (f"; for {what}: {by}" for what, (by, endings) in _OTHER_OUTPUTS.items() if suffix in endings), ""
    )
    if suffix in _OTHER_MODELS:
        hint = "; write .glb for Blender and game engines"
    description = f'is "{path.name}"' + (", a folder" if is_folder(path) else "")
    raise UsageError("USAGE", f"{name} {description}; the path must end in {', '.join(known)}{hint}")
