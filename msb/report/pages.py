"""Write a report as files: Markdown, tables in every format, and self-contained HTML pages."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.extras import need_extra
from msb.base.version import __version__
from msb.bench.folder import WALK_FILM, Results
from msb.report.compared_views import GROUND_TRUTH, data_uri, select_views
from msb.report.figures import make_sheet
from msb.report.mesh_trials import read_repairs, read_task_outcomes
from msb.report.numbers import condition_title, dataset_title, method_title, scene_title
from msb.report.safe_names import slug
from msb.report.tables.asset import asset_tables, provenance
from msb.report.writers import WRITERS, ReportFormat, escape_markdown, to_markdown

if TYPE_CHECKING:
    from jinja2 import Environment

    from msb.report.report import Report
    from msb.report.results import LoadedResult, Place
    from msb.report.verdict import Verdict

FORMATS: tuple[ReportFormat, ...] = ("md", "tex", "csv", "json", "html")
# Maximum size of an embedded video in bytes (4 MiB). Pages link to larger videos.
MAX_EMBEDDED_FILM = 4 << 20


def report_files(
    report: Report,
    *,
    formats: Collection[ReportFormat] = FORMATS,
    topology: Mapping[Place, bytes] | None = None,
    folder: Path | None = None,
) -> dict[str, bytes]:
    """Return the content of every file of the report. The keys are file names.

    Parameters
    ----------
    report : Report
    formats : collection of str
        "md", "tex", "csv", "json", "html".
    topology : mapping of Place to bytes, optional
        The topology diagnostic of each asset, as PNG.
    folder : Path, optional
        The output folder. Links to large videos are relative to this folder.

    Notes
    -----
    ``report.json`` is always written. The file names depend on the format. Markdown: ``report.md``,
    ``figures/*.svg`` and ``images/*.jpg``. LaTeX: ``figures/*.pdf`` and ``figures/topology-*.png``. Tables:
    ``tables/LABEL.*`` (md, tex, csv, json). HTML: ``index.html`` and ``verdict-DATASET-SCENE-METHOD.html``.
    Pages embed all data except large videos.
    """
    # Write the JSON of the whole report, and all tables in the text formats.
    text = json.dumps(report.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    files: dict[str, str | bytes] = {"report.json": text}
    for suffix, writer in WRITERS.items():
        if suffix in formats:
            files |= {f"tables/{label}.{suffix}": writer(table) for label, table in report.tables.items()}
    # Write charts: PDF for LaTeX, and SVG beside the Markdown.
    if "tex" in formats:
        for section in report.sections:
            sheets = [make_sheet(view) for view in section.views]
            files |= {f"figures/{figure.name}.pdf": figure.pdf() for figure in (*section.figures, *sheets)}
        files |= {
            f"figures/topology-{'-'.join(map(slug, place))}.png": image
            for place, image in (topology or {}).items()
        }
    if "md" in formats:
        files["report.md"] = _render("report.md", report=report).rstrip("\n") + "\n"
        for section in report.sections:
            files |= {f"figures/{figure.name}.svg": figure.standalone for figure in section.figures}
            files |= {f"images/{image.name}": image.data for view in section.views for image in view.images}
    # Write the index page, and a page per asset.
    if "html" in formats:
        places = [verdict.place for verdict in report.verdicts]
        pages = {place: f"verdict-{'-'.join(map(slug, place))}.html" for place in places}
        files["index.html"] = _render(report.page, report=report, pages=pages, grid=_make_grid(report))
        for verdict in report.verdicts:
            files[pages[verdict.place]] = _make_verdict_page(report, verdict, topology or {}, folder)
    return {name: text.encode() if isinstance(text, str) else text for name, text in files.items()}


def _make_grid(report: Report) -> dict[str, Any]:
    """Return the audit verdicts by dataset, scene and method for the table of assets.

    Also return all methods of the tables.
    """
    datasets: dict[str, dict[str, dict[str, Verdict]]] = {}
    methods: dict[str, None] = {}
    for verdict in report.verdicts:
        dataset, scene, method = verdict.place
        datasets.setdefault(dataset, {}).setdefault(scene, {})[method] = verdict
        methods[method] = None
    return {"datasets": datasets, "methods": list(methods)}


def _make_verdict_page(
    report: Report, verdict: Verdict, topology: Mapping[Place, bytes], folder: Path | None
) -> str:
    """Return the page of one asset."""
    assert report.results is not None
    place = verdict.place
    conditions = report.results.places[place]
    diagnostic = topology.get(place)
    records = {name: loaded.result for name, loaded in conditions.items()}
    tables = asset_tables(place, records, report.numbers)
    if not report.with_paper:
        tables = {name: table.without_paper() for name, table in tables.items()}
    audit = records["exported_mesh"].audit if "exported_mesh" in records else None
    asset = next((result.asset for result in records.values() if result.asset is not None), None)
    return _render(
        "verdict.html",
        report=report,
        verdict=verdict,
        views=select_views(report.results, [place]),
        tables=tables,
        provenance=provenance(records),
        topology=None if diagnostic is None else data_uri("image/png", diagnostic),
        asset=asset,
        outcomes=read_task_outcomes(conditions.get("exported_mesh")),
        repairs=read_repairs(conditions.get("exported_mesh")),
        audited=audit is not None,
        level=None if audit is None else audit.verdict.level,
        video=_find_video(report, place, folder),
        walks=_find_walks(conditions, folder),
    )


def _find_video(report: Report, place: Place, folder: Path | None) -> dict[str, str] | None:
    """Return the video that shows all conditions of an asset. If the video does not exist, return None."""
    assert report.results is not None
    for root in report.results.roots:
        if film := _embed_film(Results(root).video(*place), root, folder):
            return film
    return None


def _find_walks(
    conditions: Mapping[str, LoadedResult], folder: Path | None
) -> list[tuple[str, dict[str, str]]]:
    """For each condition with a video of its camera path (walk), return the title and the video."""
    return [
        (condition_title(name), film)
        for name, loaded in conditions.items()
        if loaded.result.walk is not None
        and loaded.result.walk.film is not None
        and (film := _embed_film(loaded.path.with_name(WALK_FILM), loaded.root, folder))
    ]


def _embed_film(path: Path, root: Path, folder: Path | None) -> dict[str, str] | None:
    """Return a video in the results folder `root` as {"data": data URI} or {"link": relative path}.

    Videos up to `MAX_EMBEDDED_FILM` bytes are embedded. If the file does not exist, the result is None.
    """
    # ignore an unreadable file, an invalid name, and a file on another drive
    with suppress(OSError, ValueError):
        if path.is_file() and path.resolve().is_relative_to(root.resolve()):
            if path.stat().st_size <= MAX_EMBEDDED_FILM:
                return {"data": data_uri("video/mp4", path.read_bytes())}
            start = folder or root
            return {"link": os.path.relpath(path.resolve(), start.resolve()).replace(os.sep, "/")}
    return None


@cache
def _make_environment() -> Environment:
    need_extra("bench", "jinja2", what="a page")
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("msb.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {
        "dataset": dataset_title,
        "method": method_title,
        "scene": scene_title,
        "unbroken": _bind_arrows,
        "md": escape_markdown,
        "markdown": to_markdown,
    }
    environment.globals |= {"GROUND_TRUTH": GROUND_TRUTH, "version": __version__}
    return environment


def _bind_arrows(heading: str) -> str:
    """Replace the space before each arrow of a heading by a no-break space."""
    return re.sub(" (?=[↑↓])", "\N{NO-BREAK SPACE}", heading)


def _render(template: str, **values: Any) -> str:
    return _make_environment().get_template(template).render(**values)
