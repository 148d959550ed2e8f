"""Make the report of results, and that of the paper's own tables."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from msb.base.version import __version__
from msb.bench.records import BAKED
from msb.errors import UsageError, shorten
from msb.report.against import LABEL, against_findings, against_table, comparisons
from msb.report.collect import collect
from msb.report.figures import Figure, figures
from msb.report.findings import find
from msb.report.layout import PAPER_ROW
from msb.report.numbers import Key, Number, Numbers, dataset_title, method_title
from msb.report.paper import contradictions, paper_numbers
from msb.report.pictures import View, view_names, views
from msb.report.report import Report, Section, places_of
from msb.report.results import ResultSet
from msb.report.table import Table
from msb.report.tables import measured
from msb.report.tables.bakes import bakes_table, split_table
from msb.report.tables.features import deployment_features, native_features
from msb.report.tables.gaps import gaps_table, slowdown_table
from msb.report.tables.reproducibility import SOURCES, reproducibility, reproducibility_statistics

OTHER_SCENES = (
    "{}: no scene is one of the published set, so means are over those there are and the paper's "
    "numbers are not beside them"
)
ONE_SCENE = (
    "what is significant over the views of one scene is so of that scene alone, and less sure than it looks "
    "as far as neighbouring views are alike"
)
NOTHING_AGAINST = "against {}: no other method was measured under the same condition on the same scene"
# The paper sets the scenes of these datasets side by side, and of others below each other.
FEW_SCENES = ("tanksandtemples",)
# Label of a table of the paper -> the function that makes ours, and its dataset if it is of one.
_PAPER: dict[str, tuple[Callable[..., Table], str]] = {
    "native_summary": (measured.native_summary, ""),
    "native_comprehensive_results": (measured.native_summary, ""),
    "mip360_renderer_comparison": (measured.renderer_comparison, "mipnerf360"),
    "tnt_renderer_comparison": (measured.scene_comparison, "tanksandtemples"),
    "tnt_unity_runtime_resources": (measured.runtime_resources, "tanksandtemples"),
    "mip360_unity_gpu_latency": (measured.latency, "mipnerf360"),
    "mip360_unity_memory": (measured.memory, "mipnerf360"),
    "mesh_connectivity": (measured.mesh_connectivity, "mipnerf360"),
    "reproducibility_comparison": (reproducibility, ""),
}
# Label of a table of ours -> what the paper calls it, where that is another name.
_PAPER_LABELS = {
    "renderer_comparison-mipnerf360": "mip360_renderer_comparison",
    "renderer_comparison-tanksandtemples": "tnt_renderer_comparison",
    "latency-mipnerf360": "mip360_unity_gpu_latency",
    "mesh_connectivity-mipnerf360": "mesh_connectivity",
    "reproducibility": "reproducibility_comparison",
}

# Name of a section -> its title, its introduction and the kind of its charts.
_SECTIONS = {
    "deployment": (
        "From condition to condition",
        "What each tier and engine makes of the same models, and what is lost on the way.",
        "deployment_gap",
    ),
    "gaps": ("Deployment gaps", "How much quality each step costs.", ""),
    "bakes": (
        "Where the loss is",
        "What plain assets of the models can reach, and so which part of the loss is the export's.",
        "loss_split",
    ),
    "looks": ("What it looks like", "The same test view under every condition.", ""),
    "native": ("With their own renderers", "The methods before any deployment.", ""),
    "runtime": ("Speed and memory", "What drawing costs.", "quality_speed"),
    "walk": (
        "Off the path",
        "What flickers and where holes are on a flight between and beyond the cameras.",
        "",
    ),
    "structure": (
        "Structure of the meshes",
        "Whether the exported mesh is more than a set of triangles.",
        "",
    ),
    "reproducibility": (
        "Against published results",
        "How near this run comes to what was published.",
        "reproducibility",
    ),
    "features": (
        "What each tier keeps",
        "What the representations have, and what the tiers keep of it.",
        "",
    ),
    "scenes": ("Every scene", "The numbers behind the means.", ""),
}


def build_report(
    results: ResultSet,
    *,
    published: Mapping[Key, Number] | None = None,
    chosen: Sequence[str] = (),
    pictures: bool = True,
    with_paper: bool = True,
    against: str | None = None,
) -> Report:
    """Return the report on `results`, with the paper's numbers beside ours.

    Parameters
    ----------
    published : mapping of Key to Number, optional
        More published numbers (`published_numbers`).
    chosen : sequence of str
        Views to show, "SCENE/IMAGE", besides those with the largest and a typical loss.
    pictures : bool
        Whether charts and renderings are wanted.
    with_paper : bool
        Whether the paper's numbers are wanted beside ours; those in `published` are in any case.
    against : str, optional
        A method, or its label, that every other one is held against, view by view.
    """
    _check_chosen(results, chosen)
    numbers = collect(results)
    compared = [] if against is None else comparisons(results, numbers, against)
    paper = paper_numbers() if with_paper else Numbers({}, of_paper=True)
    if published:
        paper = replace(paper, values={**paper.values, **published})
    others = [dataset for dataset in numbers.datasets() if numbers.has_other_scenes(dataset)]
    paper = _without(paper, others)
    findings = tuple(find(numbers, first=against_findings(compared, against or "")))
    charts = figures(numbers, paper) if pictures else []
    places = places_of(results, numbers) if pictures else []
    by_dataset = groupby(places, key=lambda place: place.dataset)
    shown = tuple(view for _, own in by_dataset for view in views(results, list(own), chosen))
    sections = _sections(numbers, paper, charts, shown)
    if compared and against:
        title = f"Against {method_title(against)}"
        intro = "Whether the other methods are better, and how sure that is."
        sections = (Section(LABEL, title, intro, (against_table(compared, numbers, against),)), *sections)
    notes = [*results.notes]
    notes += [ONE_SCENE] if any("views of one scene" in one.sentence for one in findings) else []
    notes += [NOTHING_AGAINST.format(against)] if against and not compared else []
    notes += [OTHER_SCENES.format(", ".join(map(dataset_title, others)))] if others and with_paper else []
    notes += [*_failures(results), *_other_renderings(results, shown)]
    summary = _summary(results, numbers)
    return Report(
        "MeshSplatBench report", summary, sections, findings, tuple(notes), numbers, results, with_paper
    )


def paper_report(*, pictures: bool = True) -> Report:
    """Return the paper's own tables, made of its numbers by the builders that make ours."""
    numbers = paper_numbers()
    own = [
        replace(build(paper_numbers(label), *filter(None, [dataset])), label=label)
        for label, (build, dataset) in _PAPER.items()
    ]
    derived = [gaps_table(numbers, dataset) for dataset in ("mipnerf360", "tanksandtemples")]
    sections = (
        Section(
            "tables",
            "The paper's tables",
            "Printed from the paper's numbers by the writer of ours.",
            _with_contradictions(*own, native_features(), deployment_features()),
        ),
        Section(
            "derived",
            "What follows from them",
            "Gaps and ratios the paper states in prose, from the means it prints.",
            _with_contradictions(*derived, slowdown_table(numbers)),
            tuple(figures(numbers)) if pictures else (),
        ),
    )
    findings = [replace(one, table=_PAPER_LABELS.get(one.table, one.table)) for one in find(numbers)]
    summary = "The tables of the MeshSplatBench paper, from its own numbers; nothing here was measured."
    return Report("The paper's tables", summary, sections, tuple(findings), (), numbers)


def _with_contradictions(*own: Table) -> tuple[Table, ...]:
    """Return tables of the paper with notes on what contradicts them elsewhere in the paper."""
    known = contradictions()
    return tuple(replace(table, notes=(*table.notes, *known.get(table.label, ()))) for table in own)


def _with_paper_notes(table: Table) -> Table:
    """Return a table of ours with notes on what contradicts the paper's numbers in it, if it has any."""
    beside = any(SOURCES["meshsplatbench"] in column.groups for column in table.columns)
    if not beside and not any(row.paper for row in table.rows):
        return table
    known = contradictions().get(_PAPER_LABELS.get(table.label, table.label), ())
    return replace(table, notes=(*table.notes, *(f"{PAPER_ROW}: {note}" for note in known)))


def _sections(
    numbers: Numbers, paper: Numbers, charts: Sequence[Figure], shown: tuple[View, ...]
) -> tuple[Section, ...]:
    datasets = numbers.datasets()
    drawn = [dataset for dataset in datasets if numbers.conditions(dataset)]
    deployed = [d for d in drawn if any(condition != "non_engine" for condition in numbers.conditions(d))]
    few = [dataset for dataset in deployed if dataset in FEW_SCENES]
    audited = [dataset for dataset in datasets if numbers.methods(dataset, "exported_mesh")]

    runtime = [slowdown_table(numbers, paper)] if deployed else []
    runtime += [measured.runtime_resources(numbers, dataset, paper) for dataset in few]
    for dataset in deployed:
        if dataset not in few:
            runtime += [measured.latency(numbers, dataset, paper), measured.memory(numbers, dataset, paper)]
        runtime += [measured.frame_time(numbers, dataset)]
    published: list[Table] = []
    if any(key.source for key in paper.values if key.dataset in datasets):
        published += [reproducibility(numbers, paper)]
        published += [reproducibility_statistics(numbers, paper)]
    made: dict[str, Iterable[Table]] = {
        "deployment": [
            *(measured.renderer_comparison(numbers, dataset, paper) for dataset in drawn),
            *(measured.scene_comparison(numbers, dataset, paper) for dataset in few),
        ],
        "gaps": (gaps_table(numbers, dataset, paper) for dataset in deployed),
        "bakes": (
            table
            for dataset in drawn
            if numbers.in_place_of(dataset, BAKED)
            for table in (split_table(numbers, dataset), bakes_table(numbers, dataset))
        ),
        "native": [measured.native_summary(numbers, paper)],
        "runtime": runtime,
        "walk": (measured.walk(numbers, dataset) for dataset in deployed if _walked(numbers, dataset)),
        "structure": (measured.mesh_connectivity(numbers, dataset, paper) for dataset in audited),
        "reproducibility": published,
        "features": [native_features(), deployment_features()],
        "scenes": (
            measured.per_scene(numbers, dataset, condition)
            for dataset in datasets
            for condition in dict.fromkeys(("non_engine", *numbers.conditions(dataset)))
        ),
    }
    sections = []
    for name, (title, intro, kind) in _SECTIONS.items():
        tables = (table for table in made.get(name, ()) if table.rows and table.columns)
        own = tuple(map(_with_paper_notes, tables))
        figures = tuple(chart for chart in charts if chart.name.partition("-")[0] == kind)
        looks = shown if name == "looks" else ()
        if own or figures or looks:
            sections.append(Section(name, title, intro, own, figures, looks))
    return tuple(sections)


def _walked(numbers: Numbers, dataset: str) -> bool:
    """Return whether a condition was walked through on a scene of a dataset."""
    return any(
        number.value is not None
        for key, number in numbers.values.items()
        if (key.dataset, key.metric) == (dataset, "flicker")
    )


def _check_chosen(results: ResultSet, chosen: Sequence[str]) -> None:
    known = {f"{place.scene}/{image}" for place in results.places for image in view_names(results, place)}
    for name in chosen:
        if name not in known:
            example = f"; {min(known)} is one" if known else ""
            raise UsageError("USAGE", f'there is no test view "{shorten(name, 80)}"{example}')


def _without(paper: Numbers, datasets: Sequence[str]) -> Numbers:
    """Return the paper's numbers without those of `datasets`: they are of other scenes."""
    return replace(
        paper,
        values={key: number for key, number in paper.values.items() if key.dataset not in datasets},
        gaps={key: gaps for key, gaps in paper.gaps.items() if key.dataset not in datasets},
        ratios={key: ratio for key, ratio in paper.ratios.items() if key.dataset not in datasets},
    )


def _summary(results: ResultSet, numbers: Numbers) -> str:
    methods = {place.method for place in results.places}
    scenes = {(place.dataset, place.scene) for place in results.places}
    of = f"{_count(len(results), 'result')} of {_count(len(methods), 'method')}"
    on = f"{_count(len(scenes), 'scene')} of {_count(len(numbers.datasets()), 'dataset')}"
    return f"{of} on {on}. msb {__version__}."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _other_renderings(results: ResultSet, shown: Iterable[View]) -> Iterator[str]:
    """Yield the renderings that are not shown, because they are not what the records say."""
    gone = [
        loaded.path.parent / image.file
        for loaded in results
        for image in loaded.images
        if loaded.file(image.file) is None
    ]
    if gone:
        more = f", and {len(gone) - 1} more" if len(gone) > 1 else ""
        yield f"rendering gone: {gone[0]}{more}; msb run draws it again"
    shots = (shot for view in shown for own in view.shots.values() for shot in own)
    for path in dict.fromkeys(shot.changed for shot in shots if shot.changed is not None):
        yield f"rendering changed since it was compared: {path}; msb run draws it again"


def _failures(results: ResultSet) -> list[str]:
    notes = []
    for loaded in results:
        reason = loaded.result.reason
        if loaded.result.status == "failed":
            why = f": {reason.code}: {reason.message}" if reason else ""
            notes.append(f"failed: {'/'.join(loaded.result.cell.names)}{why}")
    return notes
