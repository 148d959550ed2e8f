"""A folder for an artist: what was baked, what stands beside it, its numbers, a picture and a page."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.asset import ASSET_SUFFIX
from msb.asset.look import up_axis
from msb.bake.report import SCHEMA
from msb.bake.written import place_of, write_all
from msb.base.own_folder import own_folder
from msb.base.version import __version__
from msb.errors import UsageError
from msb.meshes.formats import written_suffixes
from msb.render.images import write_image

if TYPE_CHECKING:
    from msb.bake.report import Psnr, Report
    from msb.bake.run import Baked
    from msb.bake.written import Part

ASSET = "asset.glb"
PAGE = "index.html"
_DOCUMENT, _PICTURE = "bake.json", "preview.png"
_SCRIPTS = "camera.js", "page.js", "hands.js", "baked.js", "start.js"
_LEAST_SIDE = 1024  # pixels of the longer side of a view on the page; a mesh has no size of its own


def is_folder(path: Path) -> bool:
    """Return whether an output is a folder: its name has no ending, or a folder that is there has the name.

    An ending of a format names a file in any case.
    """
    is_file = path.suffix.lower() in (ASSET_SUFFIX, *written_suffixes())
    return not is_file and (not path.suffix or os.path.isdir(path))  # noqa: PTH112 - nor is a name too long


def only_folder(paths: Sequence[Path]) -> bool:
    """Return whether the output is a folder, which is written alone."""
    folder = next((path for path in paths if is_folder(path)), None)
    if folder is not None and len(paths) > 1:
        text = "it is written as a folder, which is the only output; give files, or the folder alone"
        raise UsageError("USAGE", text, file=folder)
    return folder is not None


def write_folder(baked: Baked, parts: Sequence[Part], folder: Path, overwrite: bool) -> Report:
    """Write what was baked, of these parts, as a folder, whole or not at all; return the report on it.

    It holds `ASSET` with its levels of detail and its shape beside it, the report as `bake.json`, in which
    files have their names in the folder, `preview.png`, and a page of all that.
    """
    with own_folder(folder, overwrite=overwrite) as made:
        files = write_all(parts, [made / ASSET])
        report = baked.report.written([(Path(path.name), size) for path, size in files])
        document = {"schema": SCHEMA, "tool_version": __version__, **report.to_dict()}
        text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        (made / _DOCUMENT).write_bytes(text.encode(errors="backslashreplace"))
        write_image(made / _PICTURE, baked.preview.picture, "png")
        picture = (made / _PICTURE).read_bytes()
        page = _page(baked, parts, report, folder.name, picture)
        if page is not None:
            (made / PAGE).write_bytes(page)
    return baked.report.written([(folder / path.name, size) for path, size in files])


def _page(baked: Baked, parts: Sequence[Part], report: Report, name: str, picture: bytes) -> bytes | None:
    """Return the page: each part as engines draw it, and what the report says; None without msb.engines."""
    try:
        from msb.engines.engine import engine_mesh
        from msb.engines.webpage import filled, scene_data
    except ModuleNotFoundError:
        return None
    preview = baked.preview
    views = [
        camera.scaled(max(1.0, _LEAST_SIDE / max(camera.width, camera.height))) for camera in preview.cameras
    ]
    scene = scene_data(name, views, up_axis(baked.asset), report.background)
    rows = "views that taught nothing" if report.held_back else "views that taught it, for lack of others"
    scene["baked"] = {
        "facts": _facts(report),
        "losses": _losses(report),
        "preview": f"data:image/png;base64,{_text(picture)}",
        "caption": f"From the left: {', '.join(preview.columns)}. Drawn with 16 samples a pixel, in {rows}.",
        "notes": list(report.notes),
    }
    meshes = [
        f'<script type="text/plain" data-file="{place_of(Path(ASSET), part.ending).name}">'
        f"{_text(engine_mesh(part.asset, {}).encoded('.glb'))}</script>"
        for part in parts
    ]
    return filled(scene, _SCRIPTS, arrays="\n".join(meshes))


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _facts(report: Report) -> list[list[str]]:
    """Return what the page says of each file, and of the mesh before and after."""
    facts = [[ASSET, f"{report.geometry}, {report.made}"]]
    facts += [[str(level.output), level.said] for level in report.lods]
    if report.collision is not None:
        facts.append([str(report.collision.output), report.collision.said])
    for word, verdict in (("Before", report.before), ("Now", report.after)):
        facts.append([word, f"{verdict.level.upper()}: {verdict.sentence}"])
    return facts


def _losses(report: Report) -> list[list[str]]:
    """Return the table of dB on the views held back, its head first; no row where there is none."""
    own, photographs = report.own, report.photographs
    if own is None:
        return []
    shown: list[Psnr] = [each for each in (photographs, own) if each is not None]
    head = ["dB", *(["to photographs"] if photographs else []), "to its own look"]
    table: list[tuple[str, str]] = [
        ("own look", "dedicated"),
        ("plain mesh before", "before"),
        ("baked", "after"),
        ("baked, 16 samples", "after_16"),
    ]
    rows = [[label, *(_number(getattr(each, key)) for each in shown)] for label, key in table]
    return [head, *(row for row in rows if any(row[1:]))]


def _number(value: Any) -> str:
    return "" if value is None else f"{value:.1f}"
