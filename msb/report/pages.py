"""The files of a report: Markdown, tables in every format, and pages that need nothing but themselves."""

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
from msb.report.numbers import condition_title, dataset_title, method_title, scene_title
from msb.report.pictures import GT, data_uri, views
from msb.report.safe_names import slug
from msb.report.tables.asset import asset_tables, provenance
from msb.report.tried import repairs, tried_tasks
from msb.report.writers import WRITERS, Format, markdown, markdown_text

if TYPE_CHECKING:
    from jinja2 import Environment

    from msb.report.report import Report
    from msb.report.results import Loaded, Place
    from msb.report.verdict import Verdict

FORMATS: tuple[Format, ...] = ("md", "tex", "csv", "json", "html")
# A film of at most this many bytes becomes part of the page.
SMALL_VIDEO = 4 << 20


def report_files(
    report: Report,
    *,
    formats: Collection[Format] = FORMATS,
    topology: Mapping[Place, bytes] | None = None,
    folder: Path | None = None,
) -> dict[str, bytes]:
    """Return file name -> content, for every file of the report.

    Parameters
    ----------
    report : Report
    formats : collection of str
        "md", "tex", "csv", "json", "html".
    topology : mapping of Place to bytes, optional
        The topology diagnostic of each asset, as PNG.
    folder : Path, optional
        Where the files will lie: films too large for a page are linked from there.

    Notes
    -----
    ``report.json`` in any case, ``report.md``,
    ``tables/LABEL.*``, ``figures/*.svg`` (md) and ``*.pdf`` (tex), ``images/*.jpg``, ``index.html`` and
    ``verdict-DATASET-SCENE-METHOD.html``. The pages hold all they show.
    """
    text = json.dumps(report.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    files: dict[str, str | bytes] = {"report.json": text}
    for suffix, writer in WRITERS.items():
        if suffix in formats:
            files |= {f"tables/{label}.{suffix}": writer(table) for label, table in report.tables.items()}
    if "tex" in formats:
        for section in report.sections:
            files |= {f"figures/{figure.name}.pdf": figure.pdf() for figure in section.figures}
    if "md" in formats:
        files["report.md"] = _template("report.md", report=report).rstrip("\n") + "\n"
        for section in report.sections:
            files |= {f"figures/{figure.name}.svg": figure.alone for figure in section.figures}
            files |= {f"images/{one.name}": one.data for view in section.views for one in view.pictures}
    if "html" in formats:
        places = [verdict.place for verdict in report.verdicts]
        pages = {place: f"verdict-{'-'.join(map(slug, place))}.html" for place in places}
        files["index.html"] = _template(report.page, report=report, pages=pages, grid=_grid(report))
        for verdict in report.verdicts:
            files[pages[verdict.place]] = _verdict_page(report, verdict, topology or {}, folder)
    return {name: text.encode() if isinstance(text, str) else text for name, text in files.items()}


def _grid(report: Report) -> dict[str, Any]:
    """Return the verdicts as dataset -> scene -> method -> verdict, and the methods."""
    datasets: dict[str, dict[str, dict[str, Verdict]]] = {}
    methods: dict[str, None] = {}
    for verdict in report.verdicts:
        dataset, scene, method = verdict.place
        datasets.setdefault(dataset, {}).setdefault(scene, {})[method] = verdict
        methods[method] = None
    return {"datasets": datasets, "methods": list(methods)}


def _verdict_page(
    report: Report, verdict: Verdict, topology: Mapping[Place, bytes], folder: Path | None
) -> str:
    assert report.results is not None
    place = verdict.place
    own = report.results.places[place]
    picture = topology.get(place)
    records = {name: loaded.result for name, loaded in own.items()}
    tables = asset_tables(place, records, report.numbers)
    if not report.with_paper:
        tables = {name: table.without_paper() for name, table in tables.items()}
    audit = records["exported_mesh"].audit if "exported_mesh" in records else None
    asset = next((result.asset for result in records.values() if result.asset is not None), None)
    return _template(
        "verdict.html",
        report=report,
        verdict=verdict,
        views=views(report.results, [place]),
        tables=tables,
        provenance=provenance(records),
        topology=None if picture is None else data_uri("image/png", picture),
        asset=asset,
        tried=tried_tasks(own.get("exported_mesh")),
        repairs=repairs(own.get("exported_mesh")),
        audited=audit is not None,
        level=None if audit is None else audit.verdict.level,
        video=_video(report, place, folder),
        walks=_walks(own, folder),
    )


def _video(report: Report, place: Place, folder: Path | None) -> dict[str, str] | None:
    """Return the film of an asset: its data if it is small, else its address."""
    assert report.results is not None
    for root in report.results.roots:
        if film := _film(Results(root).video(*place), root, folder):
            return film
    return None


def _walks(own: Mapping[str, Loaded], folder: Path | None) -> list[tuple[str, dict[str, str]]]:
    """Return title and film of each condition that was walked through."""
    return [
        (condition_title(name), film)
        for name, loaded in own.items()
        if loaded.result.walk is not None
        and loaded.result.walk.film is not None
        and (film := _film(loaded.path.with_name(WALK_FILM), loaded.root, folder))
    ]


def _film(path: Path, root: Path, folder: Path | None) -> dict[str, str] | None:
    """Return a film below the results folder `root`: its data if it is small, else its address."""
    with suppress(OSError, ValueError):  # not readable; a NUL in a name; another drive
        if path.is_file() and path.resolve().is_relative_to(root.resolve()):
            if path.stat().st_size <= SMALL_VIDEO:
                return {"data": data_uri("video/mp4", path.read_bytes())}
            start = folder or root
            return {"link": os.path.relpath(path.resolve(), start.resolve()).replace(os.sep, "/")}
    return None


@cache
def _environment() -> Environment:
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
        "unbroken": _unbroken,
        "md": markdown_text,
        "markdown": markdown,
    }
    environment.globals |= {"GT": GT, "version": __version__}
    return environment


def _unbroken(heading: str) -> str:
    """Keep an arrow on the line of its word."""
    return re.sub(" (?=[↑↓])", "\N{NO-BREAK SPACE}", heading)


def _template(name: str, **values: Any) -> str:
    return _environment().get_template(name).render(**values)
