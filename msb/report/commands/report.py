"""`msb report`: tables, figures, findings and pages from result records."""

from dataclasses import dataclass
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
from msb.report.writers import Format, Printed

_FOLDER = "report"
# The diagnostic of a mesh of more faces takes longer than all the rest; --topology all draws it.
_MOST_FACES = 300_000
# Options that need folders of results.
_OF_RESULTS = ("views", "published", "against", "allow_mixed")


@dataclass(frozen=True)
class ReportOptions:
    """What is reported, and how and where it is written."""

    out: Annotated[
        Path | None,
        Option("Write here instead of to RESULTS/report.", ("--out", "-o"), metavar="FOLDER", output="own"),
    ] = None
    formats: Annotated[
        str | None,
        Option("Some of md, tex, csv, json, html. Default: all.", ("--format",), metavar="LIST"),
    ] = None
    table: Annotated[
        str | None,
        Option("Print one table, as md or what --format says; write nothing.", metavar="LABEL"),
    ] = None
    paper: Annotated[
        bool | None,
        Option(
            "The paper's own tables instead of results, printed without -o; or without its numbers in any "
            "table and chart.",
            ("--paper/--no-paper",),
        ),
    ] = None
    views: Annotated[
        tuple[str, ...],
        Option("Also show this test view. May be given again.", ("--view",), metavar="SCENE/IMAGE"),
    ] = ()
    published: Annotated[
        Path | None, Option("JSON of published per-scene values to compare with.", metavar="FILE")
    ] = None
    against: Annotated[
        str | None,
        Option(
            "Also hold every other method against this one (or its label), with intervals and p.",
            metavar="METHOD",
        ),
    ] = None
    topology: Annotated[
        Literal["auto", "all", "none"],
        Option("Draw the diagnostics of small meshes, of all or of none (extra: view)."),
    ] = "auto"
    allow_mixed: Annotated[bool, Option("Accept results that must not be compared, and say so.")] = False

    def wanted(self) -> list[Format]:
        """Return the formats that are written."""
        from msb.report.pages import FORMATS

        if self.formats is None:
            return list(FORMATS)
        wanted = [part.strip() for part in self.formats.split(",")]
        for part in wanted:
            if part not in FORMATS:
                text = f'--format: "{shorten(part, 40)}" is none of {", ".join(FORMATS)}'
                raise UsageError("USAGE", text)
        return cast("list[Format]", wanted)

    def printed(self) -> Printed:
        """Return the one format in which tables are printed: Markdown, unless --format names another."""
        wanted: list[Format] = ["md"] if self.formats is None else self.wanted()
        if len(wanted) > 1 or wanted[0] == "html":
            text = f"--format: tables are printed as one of md, tex, csv, json, not {self.formats}"
            raise UsageError("USAGE", text)
        return wanted[0]


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
            "Folders that msb run wrote, of the same cell the last counts; or files of msb submit.",
            metavar="RESULTS...",
        ),
    ] = (),
    *,
    options: ReportOptions,
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Make tables, figures, findings and pages from results, with the paper's numbers beside ours.

    The command writes report.md, report.json, tables in every format, index.html, and a page per asset that
    says what the asset can be used for. Pages hold all they show and need no network. Nothing is computed
    again: what the records do not have is N/A or --, with the reason. Of submissions (.zip) it makes a board:
    one page with the rows of all, whose each is, and what does not verify is refused.
    """
    from msb.base.files import check_folder
    from msb.base.own_folder import own_folder
    from msb.bench.submission import is_submission
    from msb.report.pages import report_files

    require(folders or options.paper, "give folders of results, or --paper")
    if folders and options.paper:
        typed.reject(["paper"], "replaces folders of results, and both are given")
    if options.paper:
        typed.reject(_OF_RESULTS, "needs results and excludes --paper")
    if options.table is not None:
        typed.reject(["out"], "does not go with --table, which prints the table and writes nothing")
    wanted = options.wanted()
    board = any(is_submission(path) for path in folders)
    if board:
        if others := [path for path in folders if not is_submission(path)]:
            text = "it is no submission (.zip of msb submit); folders and submissions are reported apart"
            raise UsageError("USAGE", text, file=others[0])
        typed.reject(_OF_RESULTS, "does not go with submissions")
        require(options.out is not None or options.table is not None, "say with -o where the board goes")
    target = options.out if options.out is not None or not folders else folders[0] / _FOLDER
    if options.table is not None or target is None:
        form = options.printed()
        _print(_make(folders, options, output, pictures=False), options.table, form, output)
        return
    if not board and folders:
        check_folder(folders[0], "folder of results")
    overwrite = _check_target(target, output)
    if not {"md", "tex", "html"}.isdisjoint(wanted):
        # Before anything else is missed that a report can do without.
        need_extra("bench", "jinja2", "matplotlib", what="a report", instead="--format csv,json needs none")
    made = _make(folders, options, output, pictures=True)
    figures = _topology(made, options.topology, output) if "html" in wanted else {}
    with output.progress(f"writing {target.name}"):
        files = report_files(made, formats=wanted, topology=figures, folder=target)
        with own_folder(target, overwrite=overwrite) as folder:
            for name, data in files.items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
    output.write_json({**made.to_dict(), "files": sorted(files)})
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


def _print(made: Report, label: str | None, form: Printed, output: Output) -> None:
    """Print one table, or all."""
    from msb.report.writers import WRITERS

    if label is not None and label not in made.tables:
        labels = ", ".join(made.tables)
        raise UsageError("NAME_UNKNOWN", f'there is no table "{shorten(label, 60)}"; there are {labels}')
    tables = list(made.tables.values()) if label is None else [made.tables[label]]
    output.write_json(made.to_dict() if label is None else tables[0].to_dict())
    if output.prints_text:
        echo("\n".join(map(WRITERS[form], tables)).removesuffix("\n"))


def _make(folders: tuple[Path, ...], options: ReportOptions, output: Output, *, pictures: bool) -> Report:
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
    """Check the folder to write; return whether files of an earlier report in it are replaced.

    They are replaced without --force, too: a report is made again and again.
    """
    from msb.base.own_folder import listed_files

    replace = output.force or "report.json" in (listed_files(target) or ())
    output.check_folder(target, replace=replace)
    return replace


def _topology(made: Report, which: str, output: Output) -> dict[Place, bytes]:
    """Return the diagnostic figure, a PNG, of each audited asset that is there and can be drawn."""
    if made.results is None or which == "none":
        return {}
    figures: dict[Place, bytes] = {}
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
    except (ImportError, UsageError) as error:  # the viewers can be missing
        output.note(f"warning: no topology figures: {error}")
        return {}
    with output.counted("drawing topology figures", len(audited)) as step:
        for loaded in audited:
            try:
                figures[loaded.place] = _draw(loaded.result)
            except MsbError as error:
                output.note(f"warning: no topology figure: {error}")
            step()
    return figures


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
    audit, analysis = audit_arrays(source.vertices, source.faces, attributes=source.attributes)
    if result.audit.counts != audit.counts:
        raise InputError(
            "RECORD_INVALID", "it is not the mesh that was audited: it has changed since", file=path
        )
    model = build_model(source, audit, analysis)
    file = io.BytesIO()
    compose(model, panel_images(model)).savefig(file, format="png", dpi=90, metadata={"Software": None})
    return file.getvalue()
