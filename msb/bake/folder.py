"""The output folder of a bake: the assets, the report, a preview image and a page."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.asset import ASSET_SUFFIX
from msb.asset.look import up_axis
from msb.bake.output_files import add_ending, write_assets
from msb.bake.report import SCHEMA
from msb.base.own_folder import own_folder
from msb.base.version import __version__
from msb.errors import UsageError
from msb.meshes.formats import list_written_suffixes
from msb.render.images import write_image
from msb.scenes.framing import find_framing

if TYPE_CHECKING:
    from msb.bake.output_files import OutputAsset
    from msb.bake.report import Psnr, Report
    from msb.bake.run import Baked

ASSET = "asset.glb"
PAGE = "index.html"
_REPORT, _PREVIEW = "bake.json", "preview.png"
_SCRIPTS = "camera.js", "page.js", "controls.js", "baked.js", "start.js"
# Smallest number of pixels of the longer side of a view on the page. Smaller views are enlarged, because
# meshes can be rendered at any resolution.
_MIN_PAGE_SIDE = 1024


def is_folder(path: Path) -> bool:
    """Return whether an output path is a folder: it has no suffix, or a folder of this name exists.

    A path with the suffix of a format is always a file.
    """
    is_file = path.suffix.lower() in (ASSET_SUFFIX, *list_written_suffixes())
    return not is_file and (not path.suffix or os.path.isdir(path))  # noqa: PTH112 - is_dir() fails for long names


def is_folder_output(paths: Sequence[Path]) -> bool:
    """Return whether the output is a folder. Reject a folder among several outputs.

    Raises
    ------
    UsageError
        USAGE: a folder and other outputs are given.
    """
    folder = next((path for path in paths if is_folder(path)), None)
    if folder is not None and len(paths) > 1:
        text = "a folder must be the only output; pass either files or one folder"
        raise UsageError("USAGE", text, file=folder)
    return folder is not None


def write_folder(baked: Baked, assets: Sequence[OutputAsset], folder: Path, overwrite: bool) -> Report:
    """Write a bake as a complete folder or not at all. Return the report with the written files.

    The folder holds `ASSET`, its levels of detail, its collision shape, `preview.png` and a page. The report
    `bake.json` has relative file names.
    """
    with own_folder(folder, overwrite=overwrite) as new:
        files = write_assets(assets, [new / ASSET])
        report = baked.report.with_files([(Path(path.name), size) for path, size in files])
        document = {"schema": SCHEMA, "tool_version": __version__, **report.to_dict()}
        text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        (new / _REPORT).write_bytes(text.encode(errors="backslashreplace"))
        write_image(new / _PREVIEW, baked.preview.image, "png")
        image = (new / _PREVIEW).read_bytes()
        page = _make_page(baked, assets, report, folder.name, image)
        if page is not None:
            (new / PAGE).write_bytes(page)
    return baked.report.with_files([(folder / path.name, size) for path, size in files])


def _make_page(
    baked: Baked, assets: Sequence[OutputAsset], report: Report, name: str, image: bytes
) -> bytes | None:
    """Return the page that shows each asset and the report. Return None if `msb.engines` is not installed."""
    try:
        from msb.engines.engine import engine_mesh
        from msb.engines.webpage import fill_template, scene_to_json
    except ModuleNotFoundError:
        return None
    preview = baked.preview
    views = [
        camera.scaled(max(1.0, _MIN_PAGE_SIDE / max(camera.width, camera.height)))
        for camera in (camera.relative_to(baked.asset.manifest.origin) for camera in preview.cameras)
    ]
    scene = scene_to_json(name, views, up_axis(baked.asset), report.background, find_framing(baked.asset))
    rows = "held-out views" if report.test else "training views, because no view was held out"
    scene["baked"] = {
        "facts": _make_facts(report),
        "losses": _make_quality_table(report),
        "preview": f"data:image/png;base64,{_encode(image)}",
        "caption": (
            f"Columns: {', '.join(preview.columns)}. Rows: {rows}. Meshes are drawn with 16 samples per "
            "pixel."
        ),
        "notes": list(report.notes),
    }
    meshes = [
        f'<script type="text/plain" data-file="{add_ending(Path(ASSET), output.ending).name}">'
        f"{_encode(engine_mesh(output.asset, {}).to_bytes('.glb'))}</script>"
        for output in assets
    ]
    return fill_template(scene, _SCRIPTS, arrays="\n".join(meshes))


def _encode(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _make_facts(report: Report) -> list[list[str]]:
    """Return pairs of a term and a text for the page of results.

    The pairs list the files, and the audits of the mesh before and after the bake.
    """
    facts = [[ASSET, f"{report.geometry}, {report.size}"]]
    facts += [[str(lod.output), lod.sentence] for lod in report.lods]
    if report.collision is not None:
        facts.append([str(report.collision.output), report.collision.sentence])
    for word, verdict in (("Before", report.before), ("Now", report.after)):
        text = "Gaussian splats, not a mesh"
        facts.append([word, text if verdict is None else f"{verdict.level.upper()}: {verdict.sentence}"])
    return facts


def _make_quality_table(report: Report) -> list[list[str]]:
    """Return the head and the rows of a table of PSNR on the test views.

    Without a test view, the table is empty.
    """
    native, photographs = report.native, report.photographs
    if native is None:
        return []
    columns: list[Psnr] = [values for values in (photographs, native) if values is not None]
    head = ["PSNR in dB", *(["to photographs"] if photographs else []), "to the native renderer"]
    titles = [
        ("native renderer", "native"),
        ("unbaked mesh", "before"),
        ("baked", "after"),
        ("baked, 16 samples per pixel", "after_16"),
        ("baked, 16 samples per pixel, covered pixels only", "model_only_16"),
    ]
    rows = [[title, *(_format(getattr(values, key)) for values in columns)] for title, key in titles]
    return [head, *(row for row in rows if any(row[1:]))]


def _format(value: Any) -> str:
    return "" if value is None else f"{value:.1f}"
