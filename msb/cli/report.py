"""`msb report`: tables, figures, findings and pages from result records."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

from msb.base.extras import need_extra
from msb.cli.options import WRITTEN, Force, JsonFile, Quiet, Verbose, epilog
from msb.cli.output import Output, echo
from msb.errors import InputError, MsbError, UsageError, shorten

if TYPE_CHECKING:
    from msb.bench.records import Result
    from msb.report.report import Report
    from msb.report.results import Place
    from msb.report.table import Table
    from msb.report.writers import Format, Printed

EPILOG = epilog(
    "msb report --paper",
    "msb report --paper --table mip360_renderer_comparison --format tex",
    "msb report --paper -o out/paper --format html,tex",
)
_FOLDER = "report"
_MOST_FACES = 300_000
"""The diagnostic of a mesh of more faces takes longer than all the rest; --topology all draws it."""


def report(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="RESULTS...", help="Folders that msb run wrote; of the same cell, the last counts."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FOLDER", help="Write here instead of to RESULTS/report."),
        WRITTEN,
    ] = None,
    formats: Annotated[
        str | None,
        typer.Option("--format", metavar="LIST", help="Some of md, tex, csv, json, html. Default: all."),
    ] = None,
    table: Annotated[
        str | None,
        typer.Option(metavar="LABEL", help="Print one table, as md or what --format says; write nothing."),
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's own tables instead of results; printed without -o.")
    ] = False,
    no_paper: Annotated[
        bool, typer.Option("--no-paper", help="Leave the paper's numbers out of every table and chart.")
    ] = False,
    views: Annotated[
        list[str] | None,
        typer.Option("--view", metavar="SCENE/IMAGE", help="Also show this test view. May be given again."),
    ] = None,
    published: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="JSON of published per-scene values to compare with."),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="METHOD",
            help="Also hold every other method against this one (or its label), with intervals and p.",
        ),
    ] = None,
    topology: Annotated[
        Literal["auto", "all", "none"],
        typer.Option(help="Draw the diagnostics of small meshes, of all or of none (extra: view)."),
    ] = "auto",
    allow_mixed: Annotated[
        bool, typer.Option("--allow-mixed", help="Accept results that must not be compared, and say so.")
    ] = False,
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Make tables, figures, findings and pages from results, with the paper's numbers beside ours.

    The command writes report.md, report.json, tables in every format, index.html, and a page per asset that
    says what the asset can be used for. Pages hold all they show and need no network. Nothing is computed
    again: what the records do not have is N/A or --, with the reason.
    """
    output = Output(json_file, quiet, verbose, force)
    output.check_free(json_file)
    wanted = _formats(formats)
    if paper == bool(folders):
        raise UsageError("USAGE", "give folders of results, or --paper")
    if paper and against is not None:
        raise UsageError("USAGE", "--against compares results; the paper's tables have no single views")
    if paper and no_paper:
        raise UsageError("USAGE", "--paper and --no-paper contradict each other")
    target = out if out is not None or paper else cast("list[Path]", folders)[0] / _FOLDER
    if table is None and target is not None:
        _check_target(target, folders or [], output)
    printed = None if table is None and target is not None else _printed(formats, wanted)
    if printed is None and not {"md", "tex", "html"}.isdisjoint(wanted):
        # Before anything else is missed that a report can do without.
        need_extra("bench", "jinja2", "matplotlib", what="a report", instead="--format csv,json needs none")
    made = _make(
        folders or [], published, views or [], allow_mixed, not no_paper, not printed, against, output
    )
    if printed:
        from msb.report.writers import WRITERS

        shown = list(made.tables.values()) if table is None else [_table(made, table)]
        output.write_json(made.to_dict() if table is None else shown[0].to_dict())
        if output.prints_text:
            echo("\n".join(map(WRITERS[printed], shown)).removesuffix("\n"))
        return
    assert target is not None
    figures = {} if "html" not in wanted else _topology(made, topology, output)
    written = _write(made, wanted, figures, target, output)
    output.write_json({**made.to_dict(), "files": written})
    _summarise(made, target, output)


def _check_target(target: Path, folders: list[Path], output: Output) -> None:
    """Refuse to replace what is not a report, and without --force what somebody put into one."""
    from msb.base.atomic import check_place, is_stream
    from msb.report.pages import is_report, not_ours

    inside = any(folder.resolve().is_relative_to(target.resolve()) for folder in folders)
    own = not inside and is_report(target)
    if own and not output.force:
        if others := not_ours(target):
            text = f"the report also holds {shorten(others[0], 60)}, which --force would remove"
            raise UsageError("OUTPUT_EXISTS", text, file=target)
        check_place(target, folder=True)
        return
    empty = target.is_dir() and not any(target.iterdir())
    if target.exists() and not (own or empty or is_stream(target)):
        text = "it is no report, and all of it would be lost; give another folder with -o"
        raise UsageError("OUTPUT_EXISTS", text, file=target)
    output.check_free(target, folder=True)


def _formats(text: str | None) -> list[Format]:
    from msb.report.pages import FORMATS

    wanted = list(FORMATS) if text is None else [part.strip() for part in text.split(",")]
    for part in wanted:
        if part not in FORMATS:
            raise UsageError("USAGE", f'--format: "{shorten(part, 40)}" is none of {", ".join(FORMATS)}')
    return cast("list[Format]", wanted)


def _printed(text: str | None, wanted: list[Format]) -> Printed:
    """Return the one format in which tables are printed: Markdown, unless --format names another."""
    if text is None:
        return "md"
    if len(wanted) > 1 or wanted[0] == "html":
        raise UsageError("USAGE", f"--format: tables are printed as one of md, tex, csv, json, not {text}")
    return wanted[0]


def _make(
    folders: list[Path],
    published: Path | None,
    views: list[str],
    allow_mixed: bool,
    with_paper: bool,
    pictures: bool,
    against: str | None,
    output: Output,
) -> Report:
    from msb.report.build import build_report, paper_report
    from msb.report.paper import published_numbers
    from msb.report.results import read_results

    if not folders:
        return paper_report(pictures=pictures)
    with output.progress("reading results"):
        found = read_results(*folders, allow_mixed=allow_mixed)
        numbers = None if published is None else published_numbers(published)
    with output.progress(f"making tables and figures of {len(found)} results"):
        return build_report(
            found, published=numbers, chosen=views, pictures=pictures, with_paper=with_paper, against=against
        )


def _table(made: Report, label: str) -> Table:
    if label not in made.tables:
        labels = ", ".join(made.tables)
        raise UsageError("NAME_UNKNOWN", f'there is no table "{shorten(label, 60)}"; there are {labels}')
    return made.tables[label]


def _topology(made: Report, which: str, output: Output) -> dict[Place, bytes]:
    """Return the diagnostic figure, a PNG, of each audited asset that is there and can be drawn."""
    if made.results is None or which == "none":
        return {}
    found: dict[Place, bytes] = {}
    audited = [
        loaded
        for loaded in made.results
        if loaded.result.audit is not None
        and loaded.result.asset is not None
        and Path(loaded.result.asset.path).exists()
        and (which == "all" or loaded.result.audit.counts.faces <= _MOST_FACES)
    ]
    if not audited:
        return {}
    try:
        from msb_viewers.gl import GlProbe

        GlProbe.start().check()
    except UsageError as error:
        output.note(f"warning: no topology figures: {error}")
        return {}
    with output.counted("drawing topology figures", len(audited)) as step:
        for loaded in audited:
            try:
                found[loaded.place] = _draw(loaded.result)
            except MsbError as error:
                output.note(f"warning: no topology figure: {error}")
            step()
    return found


def _draw(result: Result) -> bytes:
    import io

    from msb.topology import audit_arrays
    from msb_viewers.figure import compose, panel_images
    from msb_viewers.model import build_model
    from msb_viewers.viewed_mesh import read_viewed_mesh

    assert result.asset is not None
    assert result.audit is not None
    path = Path(result.asset.path)
    source = read_viewed_mesh(path)
    audit, analysis = audit_arrays(source.vertices, source.faces)
    if result.audit.counts != audit.counts:
        raise InputError(
            "RECORD_INVALID", "it is not the mesh that was audited: it has changed since", file=path
        )
    model = build_model(source, audit, analysis)
    file = io.BytesIO()
    compose(model, panel_images(model)).savefig(file, format="png", dpi=90, metadata={"Software": None})
    return file.getvalue()


def _write(
    made: Report, wanted: list[Format], figures: dict[Place, bytes], target: Path, output: Output
) -> list[str]:
    from msb.base.atomic import new_folder
    from msb.report.pages import report_files

    with output.progress(f"writing {target.name}"):
        files = report_files(made, formats=wanted, topology=figures, folder=target)
        with new_folder(target) as folder:
            for name, data in files.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
    return sorted(files)


def _summarise(made: Report, target: Path, output: Output) -> None:
    if not output.prints_text:
        return
    if not output.quiet:
        echo(made.summary)
        for note in made.notes:
            echo(f"! {note}")
        for finding in made.findings:
            echo(f"- {finding.sentence}")
    page = target / "index.html"
    echo(str(page if page.exists() else target))
