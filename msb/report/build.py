"""Build the report on a set of results, and the report on the paper's own tables."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from msb.base.version import __version__
from msb.bench.records import BAKED
from msb.errors import UsageError, shorten
from msb.registry import METHODS
from msb.report.collect import collect
from msb.report.compared_views import ComparedView, select_views, view_names
from msb.report.figures import Figure, make_figures
from msb.report.findings import derive_findings
from msb.report.layout import PAPER_ROW
from msb.report.method_comparison import LABEL, compare_methods, comparison_findings, comparison_table
from msb.report.numbers import Key, Number, Numbers, dataset_title, method_title
from msb.report.paper import OUR_METHODS, as_in_paper, contradictions, paper_numbers
from msb.report.report import Report, Section, list_places
from msb.report.results import ResultSet
from msb.report.table import Table
from msb.report.tables import measurements
from msb.report.tables.bakes import bakes_table, split_table
from msb.report.tables.features import deployment_features, native_features
from msb.report.tables.gaps import gaps_table, slowdown_table
from msb.report.tables.reproducibility import SOURCES, reproducibility, reproducibility_statistics

OTHER_SCENES = (
    "{}: none of the scenes belongs to the published dataset. Means are over the scenes of this run, and the "
    "paper's numbers are not shown."
)
ONE_SCENE = (
    "Significance tests on one scene apply to that scene only. They overstate certainty when neighbouring "
    "views are similar."
)
NO_COMPARISON = "--against {}: no other method was measured under the same condition on the same scene"
# Datasets with few scenes. Tables of these datasets have one column per scene, as in the paper. The tables of
# other datasets have a row per scene.
FEW_SCENES = ("tanksandtemples",)
# For each table of the paper, the function that builds our table, and the dataset of the table. If the
# dataset is empty, the function is used for all datasets.
_PAPER: dict[str, tuple[Callable[..., Table], str]] = {
    "native_summary": (measurements.native_summary, ""),
    "native_comprehensive_results": (measurements.native_comprehensive_results, ""),
    "mip360_renderer_comparison": (measurements.renderer_comparison, "mipnerf360"),
    "tnt_renderer_comparison": (measurements.scene_comparison, "tanksandtemples"),
    "tnt_unity_runtime_resources": (measurements.runtime_resources, "tanksandtemples"),
    "mip360_unity_gpu_latency": (measurements.latency, "mipnerf360"),
    "mip360_unity_memory": (measurements.memory, "mipnerf360"),
    "mesh_connectivity": (measurements.mesh_connectivity, "mipnerf360"),
    "reproducibility_comparison": (reproducibility, ""),
}
# For each label of the paper, the label of our table.
EQUIVALENTS = {label: "-".join(filter(None, (build.__name__, at))) for label, (build, at) in _PAPER.items()}
# For each label of our tables that differs from the paper, the label in the paper.
_PAPER_LABELS = {
    "renderer_comparison-mipnerf360": "mip360_renderer_comparison",
    "renderer_comparison-tanksandtemples": "tnt_renderer_comparison",
    "latency-mipnerf360": "mip360_unity_gpu_latency",
    "mesh_connectivity-mipnerf360": "mesh_connectivity",
    "reproducibility": "reproducibility_comparison",
}

# For each section name, the title, the introduction and the kind of charts.
_SECTIONS = {
    "deployment": (
        "Quality by condition",
        "Image quality of the same models with their native renderers, on each tier and in each engine.",
        "deployment_gap",
    ),
    "gaps": ("Deployment gaps", "Loss of quality from each condition to the next.", ""),
    "bakes": (
        "Parts of the loss",
        "Quality of baked meshes, and the part of the loss that baking avoids.",
        "loss_split",
    ),
    "looks": ("Renderings", "The same test views under every condition.", ""),
    "native": ("Native renderers", "Results of the methods with their own renderers, before deployment.", ""),
    "runtime": ("Speed and memory", "Frame rate, frame time and memory of rendering.", "quality_speed"),
    "walk": (
        "Away from the captured views",
        "Flicker and holes on a camera path between and beyond the captured views.",
        "",
    ),
    "structure": ("Structure of the meshes", "Connectivity of the exported meshes.", ""),
    "reproducibility": (
        "Published results",
        "Differences between this run and published results.",
        "reproducibility",
    ),
    "features": (
        "Features kept by each tier",
        "Features of the representations, and the features that each tier keeps.",
        "",
    ),
    "scenes": ("Results per scene", "The values from which the means are computed.", ""),
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
    """Return the report on `results`.

    Parameters
    ----------
    results : ResultSet
    published : mapping of Key to Number, optional
        Further published numbers (`published_numbers`).
    chosen : sequence of str
        Views to show ("SCENE/IMAGE") in addition to the views with the largest and the median loss.
    pictures : bool
        Whether to include charts and renderings.
    with_paper : bool
        Whether to include the numbers of the paper. Numbers in `published` are always included.
    against : str, optional
        A method or label. Every other method is compared with this method in each view.
    """
    _check_chosen(results, chosen)
    numbers = collect(results)
    comparisons = [] if against is None else compare_methods(results, numbers, against)
    paper = paper_numbers() if with_paper else Numbers({}, of_paper=True)
    # If a dataset has a published name but other scenes, the paper's numbers for the dataset are removed.
    others = [dataset for dataset in numbers.datasets() if numbers.has_other_scenes(dataset)]
    paper = _drop_datasets(paper, others)
    if published:
        paper = replace(paper, values={**paper.values, **published})
    findings = tuple(derive_findings(numbers, first=comparison_findings(comparisons, against or "")))
    charts = make_figures(numbers, paper) if pictures else []
    places = list_places(results, numbers) if pictures else []
    by_dataset = groupby(places, key=lambda place: place.dataset)
    views = tuple(view for _, group in by_dataset for view in select_views(results, list(group), chosen))
    sections = _make_sections(numbers, paper, charts, views)
    if comparisons and against:
        title = f"Comparison with {method_title(against)}"
        intro = "Differences from the other methods, with confidence intervals and t tests."
        table = comparison_table(comparisons, numbers, against)
        sections = (Section(LABEL, title, intro, (table,)), *sections)
    # Warnings at the top of the report.
    notes = [*results.notes]
    notes += [ONE_SCENE] if any("views of one scene" in finding.sentence for finding in findings) else []
    notes += [NO_COMPARISON.format(against)] if against and not comparisons else []
    notes += [OTHER_SCENES.format(", ".join(map(dataset_title, others)))] if others and with_paper else []
    notes += [*_list_failures(results), *_list_changed_files(results, views)]
    summary = _summarise(results, numbers)
    return Report(
        "MeshSplatBench report", summary, sections, findings, tuple(notes), numbers, results, with_paper
    )


def paper_report(*, pictures: bool = True) -> Report:
    """Return a report on the paper's own numbers, with the tables that we also build for our results."""
    numbers = paper_numbers()
    tables = [
        replace(build(paper_numbers(label), *filter(None, [dataset])), label=label)
        for label, (build, dataset) in _PAPER.items()
    ]
    methods = [as_in_paper(method) for name, method in METHODS.items() if name in OUR_METHODS.values()]
    derived = [gaps_table(numbers, dataset) for dataset in ("mipnerf360", "tanksandtemples")]
    sections = (
        Section(
            "tables",
            "The paper's tables",
            "The paper's numbers, printed in the same way as ours.",
            _with_contradictions(*tables, native_features(methods), deployment_features(methods)),
        ),
        Section(
            "derived",
            "Derived numbers",
            "Gaps and ratios that the paper states in prose, computed from the printed means of the paper.",
            _with_contradictions(*derived, slowdown_table(numbers)),
            tuple(make_figures(numbers)) if pictures else (),
        ),
    )
    findings = [
        replace(finding, table=_PAPER_LABELS.get(finding.table, finding.table))
        for finding in derive_findings(numbers)
    ]
    summary = "The tables of the MeshSplatBench paper with its own numbers; nothing was measured here."
    return Report("The paper's tables", summary, sections, tuple(findings), (), numbers)


def _with_contradictions(*tables: Table) -> tuple[Table, ...]:
    """Return tables of the paper. Add notes on statements of the paper that contradict a table."""
    known = contradictions()
    return tuple(replace(table, notes=(*table.notes, *known.get(table.label, ()))) for table in tables)


def _with_paper_notes(table: Table) -> Table:
    """Return one of our tables.

    If the table prints numbers of the paper, add notes on contradictions in the paper.
    """
    has_columns = any(SOURCES["meshsplatbench"] in column.groups for column in table.columns)
    if not has_columns and not any(row.paper for row in table.rows):
        return table
    known = contradictions().get(_PAPER_LABELS.get(table.label, table.label), ())
    return replace(table, notes=(*table.notes, *(f"{PAPER_ROW}: {note}" for note in known)))


def _make_sections(
    numbers: Numbers, paper: Numbers, charts: Sequence[Figure], views: tuple[ComparedView, ...]
) -> tuple[Section, ...]:
    """Return the sections with at least one table, chart or view."""
    datasets = numbers.datasets()
    drawn = [dataset for dataset in datasets if numbers.conditions(dataset)]
    deployed = [d for d in drawn if any(condition != "non_engine" for condition in numbers.conditions(d))]
    # Tables of datasets with few scenes have one column per scene.
    few = [dataset for dataset in deployed if dataset in FEW_SCENES]
    audited = [dataset for dataset in datasets if numbers.methods(dataset, "exported_mesh")]

    # Choose tables by the kind of dataset. Some tables also need published numbers.
    runtime = [slowdown_table(numbers, paper)] if deployed else []
    runtime += [measurements.runtime_resources(numbers, dataset, paper) for dataset in few]
    for dataset in deployed:
        if dataset not in few:
            runtime += [
                measurements.latency(numbers, dataset, paper),
                measurements.memory(numbers, dataset, paper),
            ]
        runtime += [measurements.frame_time(numbers, dataset)]
    published: list[Table] = []
    if any(key.source for key in paper.values if key.dataset in datasets):
        published += [reproducibility(numbers, paper)]
        published += [reproducibility_statistics(numbers, paper)]
    # Build the tables of each section. Sections without tables are removed below.
    tables_of: dict[str, Iterable[Table]] = {
        "deployment": [
            *(measurements.renderer_comparison(numbers, dataset, paper) for dataset in drawn),
            *(measurements.scene_comparison(numbers, dataset, paper) for dataset in few),
        ],
        "gaps": (gaps_table(numbers, dataset, paper) for dataset in deployed),
        "bakes": (
            table
            for dataset in drawn
            if numbers.variants(dataset, BAKED)
            for table in (split_table(numbers, dataset), bakes_table(numbers, dataset))
        ),
        "native": [measurements.native_summary(numbers, paper)],
        "runtime": runtime,
        "walk": (measurements.walk(numbers, dataset) for dataset in deployed if _has_walk(numbers, dataset)),
        "structure": (measurements.mesh_connectivity(numbers, dataset, paper) for dataset in audited),
        "reproducibility": published,
        "features": [native_features(), deployment_features()],
        "scenes": [
            measurements.native_comprehensive_results(numbers, paper),
            *(
                measurements.per_scene(numbers, dataset, condition)
                for dataset in datasets
                for condition in dict.fromkeys(("non_engine", *numbers.conditions(dataset)))
            ),
        ],
    }
    sections = []
    for name, (title, intro, kind) in _SECTIONS.items():
        filled = (table for table in tables_of.get(name, ()) if table.rows and table.columns)
        tables = tuple(map(_with_paper_notes, filled))
        figures = tuple(chart for chart in charts if chart.name.partition("-")[0] == kind)
        shown_views = views if name == "looks" else ()
        if tables or figures or shown_views:
            sections.append(Section(name, title, intro, tables, figures, shown_views))
    return tuple(sections)


def _has_walk(numbers: Numbers, dataset: str) -> bool:
    """Return whether a dataset has results of a camera path (walk) beyond the captured views."""
    return any(
        number.value is not None
        for key, number in numbers.values.items()
        if (key.dataset, key.metric) == (dataset, "flicker")
    )


def _check_chosen(results: ResultSet, chosen: Sequence[str]) -> None:
    """Raise UsageError unless all views "SCENE/IMAGE" exist."""
    known = {f"{place.scene}/{image}" for place in results.places for image in view_names(results, place)}
    for name in chosen:
        if name not in known:
            example = f"; name a view such as {min(known)}" if known else ""
            raise UsageError("USAGE", f'--view: the test view "{shorten(name, 80)}" does not exist{example}')


def _drop_datasets(paper: Numbers, datasets: Sequence[str]) -> Numbers:
    """Return the paper's numbers without the numbers of `datasets`."""
    return replace(
        paper,
        values={key: number for key, number in paper.values.items() if key.dataset not in datasets},
        gaps={key: gaps for key, gaps in paper.gaps.items() if key.dataset not in datasets},
        ratios={key: ratio for key, ratio in paper.ratios.items() if key.dataset not in datasets},
    )


def _summarise(results: ResultSet, numbers: Numbers) -> str:
    """Return a text with our version and the number of results, methods, scenes and datasets."""
    methods = {place.method for place in results.places}
    scenes = {(place.dataset, place.scene) for place in results.places}
    of = f"{_format_count(len(results), 'result')} of {_format_count(len(methods), 'method')}"
    on = f"{_format_count(len(scenes), 'scene')} of {_format_count(len(numbers.datasets()), 'dataset')}"
    return f"{of} on {on}. msb {__version__}."


def _format_count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _list_changed_files(results: ResultSet, views: Iterable[ComparedView]) -> Iterator[str]:
    """Yield notes on missing and on changed renderings. Changed renderings are not shown."""
    missing = [
        loaded.path.parent / image.file
        for loaded in results
        for image in loaded.images
        if loaded.file(image.file) is None
    ]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        yield f"missing rendering: {missing[0]}{more}; msb run renders missing images again"
    renderings = (rendering for view in views for row in view.renderings.values() for rendering in row)
    for path in dict.fromkeys(rendering.changed for rendering in renderings if rendering.changed):
        yield f"changed rendering: {path} has changed since it was measured; msb run renders it again"


def _list_failures(results: ResultSet) -> list[str]:
    """Return one note per failed benchmark cell."""
    notes = []
    for loaded in results:
        reason = loaded.result.reason
        if loaded.result.status == "failed":
            why = f": {reason.code}: {reason.message}" if reason else ""
            notes.append(f"failed: {'/'.join(loaded.result.cell.names)}{why}")
    return notes
