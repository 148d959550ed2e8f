"""Tables of measurements: image quality, frame time, device memory, flicker, and connectivity of meshes."""

from collections.abc import Iterator, Mapping, Sequence

from msb.bench.aggregate import METRICS, scene_groups
from msb.bench.records import BAKED
from msb.report.collect import SOUP, WALK
from msb.report.layout import RowSpec, make_table, metric_columns, titled_row
from msb.report.metric_format import metric_title, metric_title_with_unit
from msb.report.numbers import (
    ASSET_METRICS,
    FLOOR,
    MEAN,
    MEANS,
    QUALITY,
    Key,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.safe_names import slug
from msb.report.table import NOT_AVAILABLE, NOT_SUPPORTED, Table, TableColumn

TIME_NOTE = (
    "P50 and P95: percentiles of a frame's device time in one scene, from the start of its first command to "
    "the end of its last command. The mean row averages the percentiles of the scenes"
)
MEMORY_NOTE = (
    "total size of all buffers and images after rendering all test views. Each buffer has the size that the "
    "largest view needs. The driver's own memory is not included"
)
DRIVER_NOTE = (
    "By the driver: memory of the process on an NVIDIA GPU after all test views were rendered, as reported "
    "by NVML. It includes the driver's own memory. It also includes memory that the process still holds from "
    "earlier benchmark cells"
)
PARTS_NOTES = (
    "Busy P50: sum of the times of all commands of a frame. P50 - Busy P50 is the idle time between commands",
    "Host: 1000 / FPS - P50, the wall-clock time of a frame minus its device time",
    "Rounds apart: difference in frame rate between the fastest and the slowest of five timing rounds, "
    "relative to the overall frame rate",
)
WALK_NOTES = (
    "Flicker: root mean square of the changes between frames that surface motion does not explain, in "
    "levels of 255. The flicker of a static opaque mesh with 64 samples per pixel is less than 0.3",
    "Holes: pixels that show the background instead of the model, as a share of the pixels that show the "
    "model or a hole",
)
FLOOR_NOTE = (
    "Floor: the part of the renderer's cost that does not depend on the mesh. It is measured with a single "
    "triangle and the shared texture or network, at the size of the largest view. The cost is averaged over "
    "scenes"
)
# Notes on the interpretation of connectivity metrics (paper, "Interpretation").
STRUCTURE_NOTES = (
    "of the mesh as stored: faces and vertices were not merged, removed or repaired",
    "boundaries are not always errors. Open scenes, sheets and unseen parts of a surface have boundaries",
    "V/F and valence measure how often vertices are shared, not manifoldness or accuracy. Seams of UVs, "
    "normals and materials duplicate vertices, which raises V/F",
    "the number of components and the size of the largest component (LCC) do not measure accuracy or "
    "manifoldness. The number of components depends on the resolution and the scene. Compare it with the "
    "LCC fractions, and look at the mesh",
    "self-intersections are not examined",
)
# Metrics of native renderings, in addition to image quality.
_NATIVE = ("fps", "train_memory", "train_seconds", "chamfer")
_PERCENTILES = ("p50_ms", "p95_ms")
_FRAME_PARTS = ("fps", "p50_ms", "spread_ms", "busy_p50_ms", "host_ms", "unsteady")
# Three groups of metrics, as in the paper's table with eight columns.
_CONNECTIVITY = {
    "Local reuse": ("vf_ratio", "mean_valence"),
    "Local structure": ("boundary_edge_ratio", "nonmanifold_edge_ratio", "nonmanifold_vertex_ratio"),
    "Global connectivity": ("lcc_face_ratio", "lcc_area_ratio", "components"),
}
# For each mean over a group of scenes, the heading of the group.
_GROUPS = {"indoor_mean": "indoor scenes", "outdoor_mean": "outdoor scenes"}


def native_rows(numbers: Numbers, *, asset_metrics: Sequence[str] = ()) -> list[RowSpec]:
    """Return a row for each dataset and method that has native renderings or values of `asset_metrics`."""
    return [
        titled_row(dataset=dataset, method=method)
        for dataset in numbers.datasets()
        for method in numbers.methods(dataset, "non_engine", asset_metrics=asset_metrics)
    ]


def _deployment_rows(numbers: Numbers, dataset: str) -> list[RowSpec]:
    """Return a row for each deployed condition of each method on a dataset."""
    conditions = [condition for condition in numbers.conditions(dataset) if condition != "non_engine"]
    return [
        titled_row(condition=condition, method=method)
        for condition in conditions
        for method in numbers.methods(dataset, *conditions)
    ]


def _scene_rows(
    numbers: Numbers,
    dataset: str,
    *,
    groups: Sequence[str] = tuple(_GROUPS),
    group_means: bool = True,
    prefix: str = "",
    of: Mapping[str, str] | None = None,
) -> Iterator[RowSpec]:
    """Yield a row for each scene and for each mean. For a dataset without scenes, yield only the mean.

    Parameters
    ----------
    numbers : Numbers
    dataset : str
    groups : sequence of str
        The groups of scenes of the dataset, in table order.
    group_means : bool
        Whether each group ends with its mean. If the value is false, only the last row is a mean, and this
        row is bold.
    prefix : str
        First words of the name of each section.
    of : mapping of str to str, optional
        Key fields that all rows share.
    """
    members = scene_groups(dataset)

    def make_row(scene: str, *section: str, bold: bool = False) -> RowSpec:
        heading = ", ".join(filter(None, (prefix, *section)))
        return RowSpec((scene_title(scene),), {"scene": scene, **(of or {})}, heading, scene in MEANS, bold)

    # The scenes of a group come first, then scenes without a group, then the mean.
    remaining = numbers.scenes(dataset)
    for group in groups if members else ():
        of_group = [scene for scene in remaining if scene in members[group]]
        remaining = [scene for scene in remaining if scene not in of_group]
        for name in (*of_group, *([group] if of_group and group_means else [])):
            yield make_row(name, _GROUPS[group])
    for scene in remaining:
        yield make_row(scene, "other scenes" if members else "")
    yield make_row(MEAN, "all scenes" if members and prefix else "", bold=not group_means)


def _has_floor(numbers: Numbers, dataset: str) -> bool:
    """Return whether the cost of a single triangle was measured on a dataset."""
    return any(
        number.value is not None
        for key, number in numbers.values.items()
        if (key.dataset, key.scene) == (dataset, FLOOR)
    )


def _floor_rows(numbers: Numbers, dataset: str) -> list[RowSpec]:
    """If a single triangle was timed, return a row with its cost."""
    if not _has_floor(numbers, dataset):
        return []
    return [RowSpec((scene_title(FLOOR),), {"scene": FLOOR}, "one triangle")]


def native_summary(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return the results of the methods with their native renderers. The best method of a dataset is bold."""
    return make_table(
        numbers,
        paper,
        "native_summary",
        "Non-Engine results: each method with its native renderer, means over the scenes of a dataset.",
        ("Dataset", "Method"),
        metric_columns((*QUALITY, *_NATIVE)),
        native_rows(numbers, asset_metrics=ASSET_METRICS),
        {"scene": MEAN, "condition": "non_engine"},
        best_of=("dataset",),
    )


def native_comprehensive_results(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return the columns of `native_summary` for each scene and for each mean.

    The best method of a scene is bold.
    """
    return make_table(
        numbers,
        paper,
        "native_comprehensive_results",
        "Non-Engine results of every scene, and means over the scenes of a dataset.",
        ("Dataset", "Scene", "Method"),
        metric_columns((*QUALITY, *_NATIVE)),
        [
            titled_row(dataset=dataset, scene=scene, method=method)
            for dataset in numbers.datasets()
            for scene in (*numbers.scenes(dataset), MEAN)
            for method in numbers.methods(dataset, "non_engine", asset_metrics=ASSET_METRICS)
        ],
        {"condition": "non_engine"},
        best_of=("dataset", "scene"),
    )


def renderer_comparison(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return a table with a row for each condition and metric, and a column for each method. The best
    condition is bold.

    Standard comes before Dedicated, as in the paper.
    """
    conditions = sorted(numbers.conditions(dataset), key=_comparison_order)
    return make_table(
        numbers,
        paper,
        f"renderer_comparison-{slug(dataset)}",
        f"{dataset_title(dataset)}: the same models under each condition, means over scenes. Bold: the best "
        "condition of each method.",
        ("Condition", "Drawn", "Metric"),
        [
            TableColumn(method_title(method), (), {"method": method})
            for method in numbers.methods(dataset, *conditions)
        ],
        [
            RowSpec(
                (
                    condition_title(condition),
                    f"by {by}" if (by := numbers.drawn_by.get(dataset, {}).get(condition)) else NOT_AVAILABLE,
                    metric_title(metric),
                ),
                {"condition": condition, "metric": metric},
            )
            for condition in conditions
            for metric in (*QUALITY, "fps")
        ],
        {"dataset": dataset, "scene": MEAN},
        best_of=("method",),
    )


def _comparison_order(condition: str) -> int:
    """Return the sort key of a condition in `renderer_comparison`."""
    return ("non_engine", "standard", "dedicated", BAKED).index(condition.partition("/")[0])


def scene_comparison(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return a table with a row for each deployed condition of each method, and a block of columns for each
    scene.

    The best deployment of each method in each scene is bold.
    """
    scenes = [*numbers.scenes(dataset), MEAN]
    return make_table(
        numbers,
        paper,
        f"scene_comparison-{slug(dataset)}",
        f"{dataset_title(dataset)}: Dedicated and Standard deployment per scene. Bold: the best deployment "
        "of each method.",
        ("Condition", "Method"),
        [
            column
            for scene in scenes
            for column in metric_columns((*QUALITY, "fps"), scene_title(scene), scene=scene)
        ],
        _deployment_rows(numbers, dataset),
        {"dataset": dataset},
        best_of=("method", "scene"),
    )


def per_scene(numbers: Numbers, dataset: str, condition: str) -> Table:
    """Return a table with a row of results for each scene, under one condition. Each method has a block of
    columns in the table.

    The best method of each scene is bold.
    """
    # Methods without images also have a column for the Chamfer distance on DTU.
    chamfer = ("chamfer",) if (dataset, condition) == ("dtu", "non_engine") else ()
    with_images = numbers.methods(dataset, condition)
    return make_table(
        numbers,
        None,
        f"scenes-{slug(dataset)}-{slug(condition)}",
        f"{dataset_title(dataset)}, {condition_title(condition)}: results per scene. Bold: the best method.",
        ("Scene",),
        [
            column
            for method in numbers.methods(dataset, condition, asset_metrics=chamfer)
            for column in metric_columns(
                (*QUALITY, "fps", *chamfer) if method in with_images else chamfer,
                method_title(method),
                method=method,
            )
        ],
        _scene_rows(numbers, dataset),
        {"dataset": dataset, "condition": condition},
        best_of=("scene",),
    )


def latency(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the percentiles P50 and P95 of the frame time for each scene and deployment."""
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    columns = [
        TableColumn(
            METRICS[metric].title,
            (f"{condition_title(condition)} (ms ↓)", method_title(method)),
            {"condition": condition, "method": method, "metric": metric},
        )
        for condition, method in pairs
        for metric in _PERCENTILES
    ]
    return make_table(
        numbers,
        paper,
        f"latency-{slug(dataset)}",
        f"{dataset_title(dataset)}: device time of a frame per scene, in ms; lower is better.",
        ("Scene",),
        columns,
        [*_scene_rows(numbers, dataset), *_floor_rows(numbers, dataset)],
        {"dataset": dataset},
        definitions=(TIME_NOTE, FLOOR_NOTE),
        notes=omitted,
    )


def frame_time(numbers: Numbers, dataset: str) -> Table:
    """Return the table of the parts of the frame time: busy device time, idle time and host time."""
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    return make_table(
        numbers,
        None,
        f"frame_time-{slug(dataset)}",
        f"{dataset_title(dataset)}: parts of the frame time, means over scenes.",
        ("Condition", "Method"),
        [TableColumn(metric_title_with_unit(metric), (), {"metric": metric}) for metric in _FRAME_PARTS],
        [titled_row(condition=condition, method=method) for condition, method in pairs],
        {"dataset": dataset, "scene": MEAN},
        definitions=(TIME_NOTE, *PARTS_NOTES),
        notes=omitted,
    )


def walk(numbers: Numbers, dataset: str) -> Table:
    """Return the table of flicker and holes on a camera path (walk) beyond the captured views.

    Each method's best condition is bold.
    """
    pairs, omitted = _deployments(numbers, dataset, "flicker", bakes=True)
    return make_table(
        numbers,
        None,
        f"walk-{slug(dataset)}",
        f"{dataset_title(dataset)}: a walk between and beyond the captured views, means over scenes. Bold: "
        "the best condition of each method.",
        ("Condition", "Method"),
        [TableColumn(metric_title_with_unit(metric), (), {"metric": metric}) for metric in WALK],
        [titled_row(condition=condition, method=method) for condition, method in pairs],
        {"dataset": dataset, "scene": MEAN},
        best_of=("method",),
        definitions=WALK_NOTES,
        notes=omitted,
    )


def memory(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the table of device memory for each scene and deployment."""
    pairs, omitted = _deployments(numbers, dataset, "memory")
    # Each condition and method has a column. If the driver reports memory, an additional column shows this
    # memory.
    columns = []
    by_driver = False
    for condition, method in pairs:
        of = {"condition": condition, "method": method}
        group, name = (f"{condition_title(condition)} (MiB ↓)",), method_title(method)
        columns.append(TableColumn(name, group, {**of, "metric": "memory"}))
        if numbers.value(Key(dataset, MEAN, method, condition, "driver_memory")) is not None:
            columns.append(TableColumn(f"{name}, by the driver", group, {**of, "metric": "driver_memory"}))
            by_driver = True
    return make_table(
        numbers,
        paper,
        f"memory-{slug(dataset)}",
        f"{dataset_title(dataset)}: device memory per scene, in MiB; lower is better.",
        ("Scene",),
        columns,
        [*_scene_rows(numbers, dataset), *_floor_rows(numbers, dataset)],
        {"dataset": dataset},
        definitions=(MEMORY_NOTE, *((DRIVER_NOTE,) if by_driver else ()), FLOOR_NOTE),
        notes=omitted,
    )


def runtime_resources(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the table of frame time, memory and asset size for a dataset with few scenes.

    The scenes are side by side.
    """
    # Titles of the columns. The keys are heading and metric. For each scene and each mean, every metric of a
    # block has a column.
    blocks = {
        "Device time of a frame (ms ↓)": {metric: METRICS[metric].title for metric in _PERCENTILES},
        "Memory (MiB ↓)": {"memory": "Render", "asset_size": METRICS["asset_size"].title},
    }
    floor = (FLOOR,) if _has_floor(numbers, dataset) else ()
    columns = [
        TableColumn(name, (heading, scene_title(scene)), {"scene": scene, "metric": metric})
        for heading, names in blocks.items()
        for scene in (*numbers.scenes(dataset), MEAN, *floor)
        for metric, name in names.items()
        if (scene, metric) != (FLOOR, "asset_size")
    ]
    return make_table(
        numbers,
        paper,
        f"runtime_resources-{slug(dataset)}",
        f"{dataset_title(dataset)}: device time (ms), memory while rendering and size of the asset (MiB).",
        ("Condition", "Method"),
        columns,
        _deployment_rows(numbers, dataset),
        {"dataset": dataset},
        definitions=(
            TIME_NOTE,
            f"Render: {MEMORY_NOTE}; Asset: size of the asset's files, equal on both tiers",
            *((FLOOR_NOTE,) if floor else ()),
        ),
    )


def _deployments(
    numbers: Numbers, dataset: str, metric: str, *, bakes: bool = False
) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    """Return the pairs (condition, method) of a table for `metric`. For each unsupported pair of condition
    and method, return a note.

    Bakes are included only if `bakes` is true, because the cost of bakes has a separate table.
    """
    pairs, omitted = [], []
    for condition in numbers.conditions(dataset):
        if condition == "non_engine" or (condition.startswith(f"{BAKED}/") and not bakes):
            continue
        for method in numbers.methods(dataset, condition):
            number = numbers.number(Key(dataset, MEAN, method, condition, metric))
            if number.value is None and number.absent == NOT_SUPPORTED:
                why = f": {number.reason}" if number.reason else ""
                omitted.append(f"{method_title(method)} is N/A under {condition_title(condition)}{why}")
            else:
                pairs.append((condition, method))
    return pairs, tuple(omitted)


def connectivity_columns() -> list[TableColumn]:
    """Return the columns of the connectivity metrics."""
    return [column for block, metrics in _CONNECTIVITY.items() for column in metric_columns(metrics, block)]


def mesh_connectivity(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the table of connectivity for every exported mesh of a dataset.

    Triangle soups come last. The mean is bold.
    """

    def is_soup(method: str) -> bool:
        mean = Key(dataset, MEAN, method, "exported_mesh", "nonmanifold_vertex_ratio")
        return SOUP in numbers.number(mean).notes

    methods = sorted(numbers.methods(dataset, "exported_mesh"), key=is_soup)
    method_name = f" of {method_title(methods[0])}" if len(methods) == 1 else ""
    return make_table(
        numbers,
        paper,
        f"mesh_connectivity-{slug(dataset)}",
        f"{dataset_title(dataset)}: connectivity of the exported meshes{method_name}, as stored.",
        ("Scene",),
        connectivity_columns(),
        [
            row
            for method in methods
            for row in _scene_rows(
                numbers,
                dataset,
                groups=("outdoor_mean", "indoor_mean"),
                group_means=False,
                prefix=method_title(method) if len(methods) > 1 else "",
                of={"method": method},
            )
        ],
        {"dataset": dataset, "condition": "exported_mesh"},
        definitions=STRUCTURE_NOTES,
    )
