"""The command `msb report`: tables, charts, findings and pages from results."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, cast

from msb.base.extras import need_extra
from msb.base.option import Argument, Option
from msb.bench.records import Result
from msb.cli.command import Typed, command, require
from msb.cli.output import JsonOutput, Output, echo
from msb.errors import InputError, MsbError, UsageError, shorten
from msb.report.report import Report
from msb.report.results import Place
from msb.report.writers import ReportFormat, TableFormat

# Default folder of reports, within the results folder.
_FOLDER = "report"
# Maximum number of faces of a mesh whose diagnostic image is drawn by default. For a larger mesh, drawing the
# diagnostic image takes longer than the remaining report.
_MAX_DIAGNOSTIC_FACES = 300_000
# Options that require folders of results.
_RESULTS_OPTIONS = ("views", "published", "against", "allow_mixed")


@dataclass(frozen=True)
class ReportOptions:
    """The content, the formats and the folder of a report."""

    out: Annotated[
        Path | None,
        Option(
            "Write the report to FOLDER. Default: RESULTS/report.",
            ("--out", "-o"),
            metavar="FOLDER",
            output="own",
        ),
    ] = None
    formats: Annotated[
        str | None,
        Option(
            "Formats to write: any of md, tex, csv, json, html. Default: all.", ("--format",), metavar="LIST"
        ),
    ] = None
    table: Annotated[
        str | None,
        Option("Print one table (as md, or in the given --format) without writing files.", metavar="LABEL"),
    ] = None
    paper: Annotated[
        bool | None,
        Option(
            "--paper reports the paper's own tables instead of results. --no-paper leaves out the paper's "
            "numbers.",
            ("--paper/--no-paper",),
        ),
    ] = None
    views: Annotated[
        tuple[str, ...],
        Option("Also show this test view. Repeatable.", ("--view",), metavar="SCENE/IMAGE"),
    ] = ()
    published: Annotated[
        Path | None, Option("Compare with published values per scene, read from a JSON file.", metavar="FILE")
    ] = None
    against: Annotated[
        str | None,
        Option(
            "Compare every other method with this method or label, with confidence intervals and t tests.",
            metavar="METHOD",
        ),
    ] = None
    topology: Annotated[
        Literal["auto", "all", "none"],
        Option("Draw diagnostic images of small meshes (auto), of all meshes, or of none (extra: view)."),
    ] = "auto"
    allow_mixed: Annotated[bool, Option("Accept results that must not be compared, and add a note.")] = False

    def written_formats(self) -> list[ReportFormat]:
        """Return the formats to write; raises UsageError for an unknown format."""
        from msb.report.pages import FORMATS

        if self.formats is None:
            return list(FORMATS)
        formats = [part.strip() for part in self.formats.split(",")]
        for name in formats:
            if name not in FORMATS:
                text = f'--format: unknown format "{shorten(name, 40)}"; choose from {", ".join(FORMATS)}'
                raise UsageError("USAGE", text)
        return cast("list[ReportFormat]", formats)

    def printed_format(self) -> TableFormat:
        """Return the format of printed tables. The default is Markdown.

        Raises UsageError if html or several formats are named.
        """
        formats: list[ReportFormat] = ["md"] if self.formats is None else self.written_formats()
        if len(formats) > 1 or formats[0] == "html":
            text = f"--format: tables cannot be printed as {self.formats}; choose one of md, tex, csv, json"
            raise UsageError("USAGE", text)
        return formats[0]


@command(
    "msb report --paper",
    "msb report --paper --table mip360_renderer_comparison --format tex",
    "msb report --paper -o out/paper --format html,tex",
    "msb report -o out/board out/ours.zip",
)
def report(
    folders: Annotated[
        tuple[Path, ...],
        Argument(
            "Results folders of msb run, or files of msb submit. If two folders have the same cell, the last "
            "folder counts.",
            metavar="RESULTS...",
        ),
    ] = (),
    *,
    options: ReportOptions,
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Write tables, charts, findings and pages on results, with the paper's numbers beside them.

    The command writes report.md, report.json, tables in every format, index.html, and a page per asset with a
    verdict on its uses. All HTML pages work offline. The command only reads results: missing values are
    printed as N/A or --, with the reason. For submissions (.zip), the command writes a board: one page with
    the results of all submitters. Submissions that fail verification are rejected.
    """
    from msb.base.files import check_folder
    from msb.base.own_folder import own_folder
    from msb.bench.submission import is_submission
    from msb.report.pages import report_files

    require(folders or options.paper, "Missing RESULTS. Pass results folders, or --paper")
    if folders and options.paper:
        typed.reject(["paper"], "cannot be combined with results folders")
    if options.paper:
        typed.reject(_RESULTS_OPTIONS, "needs results folders and cannot be combined with --paper")
    if options.table is not None:
        typed.reject(["out"], "cannot be combined with --table, which prints a table without writing files")
    formats = options.written_formats()
    # Options that select or compare results do not apply to a board of submissions.
    board = any(is_submission(path) for path in folders)
    if board:
        if others := [path for path in folders if not is_submission(path)]:
            text = "this is not a submission (.zip of msb submit); report folders and submissions separately"
            raise UsageError("USAGE", text, file=others[0])
        typed.reject(_RESULTS_OPTIONS, "cannot be combined with submissions")
        has_output = options.out is not None or options.table is not None
        require(has_output, "Missing output. Pass -o with the folder of the board")
    target = options.out if options.out is not None or not folders else folders[0] / _FOLDER
    # Print the tables without writing files.
    if options.table is not None or target is None:
        form = options.printed_format()
        _print_tables(_build(folders, options, output, pictures=False), options.table, form, output)
        return
    if not board and folders:
        check_folder(folders[0], "folder of results")
    overwrite = _check_target(target, output)
    if not {"md", "tex", "html"}.isdisjoint(formats):
        # Check the installed packages before the computation, which takes long.
        need_extra("bench", "jinja2", "matplotlib", what="a report", instead="--format csv,json needs none")
    # Build and write the report.
    built = _build(folders, options, output, pictures=True)
    diagnostics = _draw_diagnostics(built, options.topology, output) if "html" in formats else {}
    with output.progress(f"writing {target.name}"):
        files = report_files(built, formats=formats, topology=diagnostics, folder=target)
        with own_folder(target, overwrite=overwrite) as folder:
            for name, data in files.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
    output.write_json({**built.to_dict(), "files": sorted(files)})
    if not output.prints_text:
        return
    if not output.quiet:
        echo(built.summary)
        for note in built.notes:
            echo(f"! {note}")
        for finding in built.findings:
            echo(f"- {finding.sentence}")
    page = target / "index.html"
    echo(str(page if page.exists() else target))


def _print_tables(report: Report, label: str | None, form: TableFormat, output: Output) -> None:
    """Print the table called `label`, or all tables."""
    from msb.report.build import EQUIVALENTS
    from msb.report.writers import WRITERS

    chosen = None if label is None else report.tables.get(label)
    if label is not None and chosen is None and EQUIVALENTS.get(label) in report.tables:
        # The user passed a label of the paper. Print our table with the paper's label, so that references in
        # a text stay valid.
        chosen = replace(report.tables[EQUIVALENTS[label]], label=label)
    if label is not None and chosen is None:
        text = f'the table "{shorten(label, 60)}" does not exist; choose from {", ".join(report.tables)}'
        raise UsageError("NAME_UNKNOWN", text)
    tables = list(report.tables.values()) if chosen is None else [chosen]
    output.write_json(report.to_dict() if label is None else tables[0].to_dict())
    if output.prints_text:
        echo("\n".join(map(WRITERS[form], tables)).removesuffix("\n"))


def _build(folders: tuple[Path, ...], options: ReportOptions, output: Output, *, pictures: bool) -> Report:
    """Return a report on results or a board of submissions.

    If `folders` is empty, return the paper's own report.
    """
    from msb.bench.submission import is_submission, read_submission
    from msb.report.board import build_board
    from msb.report.build import build_report, paper_report
    from msb.report.paper import published_numbers
    from msb.report.results import read_results

    if not folders:
        return paper_report(pictures=pictures)
    if is_submission(folders[0]):
        with output.counted("verifying submissions", len(folders)) as step:
            submissions = []
            for path in folders:
                submissions.append(read_submission(path))
                step()
        return build_board(submissions, with_paper=options.paper is not False, pictures=pictures)
    with output.progress("reading results"):
        results = read_results(*folders, allow_mixed=options.allow_mixed)
        published = None if options.published is None else published_numbers(options.published)
    with output.progress(f"making tables and figures of {len(results)} results"):
        return build_report(
            results,
            published=published,
            chosen=options.views,
            pictures=pictures,
            with_paper=options.paper is not False,
            against=options.against,
        )


def _check_target(target: Path, output: Output) -> bool:
    """Check the output folder. Return whether the folder contains files of an earlier report, which will be
    replaced.

    Replace the files of an earlier report even without --force, because reports are usually repeated.
    """
    from msb.base.own_folder import listed_files

    replace = output.force or "report.json" in (listed_files(target) or ())
    output.check_folder(target, replace=replace)
    return replace


def _draw_diagnostics(report: Report, which: str, output: Output) -> dict[Place, bytes]:
    """Return the diagnostic image (PNG) of each audited asset whose file exists and can be drawn."""
    if report.results is None or which == "none":
        return {}
    diagnostics: dict[Place, bytes] = {}
    audited = [
        loaded
        for loaded in report.results
        if loaded.result.audit is not None
        and loaded.result.asset is not None
        and Path(loaded.result.asset.path).exists()
        and (which == "all" or loaded.result.audit.counts.faces <= _MAX_DIAGNOSTIC_FACES)
    ]
    if not audited:
        return {}
    try:
        from msb_viewers.gl import GlProbe

        GlProbe.start().check()
    except (ImportError, UsageError) as error:  # the viewers are an optional part of the package
        output.note(f"warning: mesh diagnostics cannot be drawn: {error}")
        return {}
    with output.counted("drawing mesh diagnostics", len(audited)) as step:
        for loaded in audited:
            try:
                diagnostics[loaded.place] = _draw_diagnostic(loaded.result)
            except MsbError as error:
                output.note(f"warning: a mesh diagnostic cannot be drawn: {error}")
            step()
    return diagnostics


def _draw_diagnostic(result: Result) -> bytes:
    """Return the diagnostic image of an asset. Raises InputError if the mesh has changed since its audit."""
    import io

    from msb.topology import audit_arrays
    from msb_viewers.figure import compose, render_columns
    from msb_viewers.model import build_model
    from msb_viewers.viewed_mesh import read_viewed_mesh

    assert result.asset is not None
    assert result.audit is not None
    path = Path(result.asset.path)
    source = read_viewed_mesh(path)
    audit, analysis = audit_arrays(source.vertices, source.faces, attributes=source.attributes)
    if result.audit.counts != audit.counts:
        raise InputError("RECORD_INVALID", "the mesh has changed since it was audited", file=path)
    model = build_model(source, audit, analysis)
    file = io.BytesIO()
    compose(model, render_columns(model)).savefig(file, format="png", dpi=90, metadata={"Software": None})
    return file.getvalue()
