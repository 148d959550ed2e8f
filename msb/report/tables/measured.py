"""Tables of what was measured: image quality, device time and memory, and the structure of meshes."""

from collections.abc import Iterator, Mapping, Sequence

from msb.bench.aggregate import METRICS, scene_groups
from msb.bench.records import BAKED
from msb.report.collect import SOUP, WALK
from msb.report.layout import Line, line, make_table, metric_columns
from msb.report.metric_format import title, title_with_unit
from msb.report.numbers import (
    FLOOR,
    MEAN,
    MEANS,
    OF_ASSET,
    QUALITY,
    Key,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.safe_names import slug
from msb.report.table import NOT_SUPPORTED, NOT_THERE, Column, Table

TIME_NOTE = (
    "P50 and P95 of the device time of a frame, from the start of its first command to the end of its last, "
    "per scene; a mean is the mean of the scenes' percentiles"
)
MEMORY_NOTE = (
    "bytes of all buffers and images held after every test view was drawn, each as large as the most "
    "demanding view needs; without the driver's own, which NVIDIA's alone tells, and not on Windows"
)
DRIVER_NOTE = (
    "By the driver: all that the process held on NVIDIA's GPUs then, as NVML tells it, with what the driver "
    "itself takes and what earlier cells of the same process left"
)
PARTS_NOTES = (
    "Busy P50: the sum of the times of a frame's commands; P50 less it is time between commands",
    "Host: 1000 / FPS - P50, the part of a frame's wall-clock time outside of the device's work on it",
    "Rounds apart: the fastest less the slowest of five rounds of frames, as a share of the frame rate",
)
WALK_NOTES = (
    "Flicker: the change from frame to frame that the motion of what is seen does not explain, in levels of "
    "255 (root mean square); a static opaque mesh at 64 samples a pixel has less than 0.3",
    "Holes: pixels that show the background where the model should be, as a share of those of the model",
)
FLOOR_NOTE = (
    "Floor: one triangle of the model, with the texture or network that its triangles share, at the size of "
    "the largest view, the mean over scenes: what a renderer takes whatever the mesh is"
)
# What must be known to read the diagnostics of a mesh (paper, "Interpretation").
STRUCTURE_NOTES = (
    "of the mesh as it is stored: nothing was merged, removed or repaired before",
    "a boundary may be legitimate: of an open scene, of a sheet, of what no camera saw",
    "V/F and valence measure how often vertices are reused, not whether the mesh is manifold or its geometry "
    "right; seams of UVs, normals and materials double vertices in place, which raises V/F",
    "components and their largest one say nothing of right geometry or of manifoldness; their number depends "
    "on the resolution of the mesh and on the scene, so it is read with the LCC fractions and by looking at "
    "the mesh",
    "self-intersections are not looked at",
)
# The metrics of a method's own images, besides those of `QUALITY`.
_NATIVE = ("fps", "train_memory", "train_seconds", "chamfer")
_TIMES = ("p50_ms", "p95_ms")
_PARTS = ("fps", "p50_ms", "spread_ms", "busy_p50_ms", "host_ms", "unsteady")
# The paper's three groups of its eight columns.
_CONNECTIVITY = {
    "Local reuse": ("vf_ratio", "mean_valence"),
    "Local structure": ("boundary_edge_ratio", "nonmanifold_edge_ratio", "nonmanifold_vertex_ratio"),
    "Global connectivity": ("lcc_face_ratio", "lcc_area_ratio", "components"),
}
_GROUPS = {"indoor_mean": "indoor scenes", "outdoor_mean": "outdoor scenes"}


def native_lines(numbers: Numbers, *, of_asset: Sequence[str] = ()) -> list[Line]:
    """Return a line per dataset and method with images of the method's own renderer.

    Numbers of the model itself, such as what its training took, do as well: those of the metrics `of_asset`.
    """
    return [
        line(dataset=dataset, method=method)
        for dataset in numbers.datasets()
        for method in numbers.methods(dataset, "non_engine", of_asset=of_asset)
    ]


def _deployment_lines(numbers: Numbers, dataset: str) -> list[Line]:
    """Return a line per deployed condition and method of a dataset."""
    conditions = [condition for condition in numbers.conditions(dataset) if condition != "non_engine"]
    return [
        line(condition=condition, method=method)
        for condition in conditions
        for method in numbers.methods(dataset, *conditions)
    ]


def _scene_lines(
    numbers: Numbers,
    dataset: str,
    *,
    groups: Sequence[str] = tuple(_GROUPS),
    group_means: bool = True,
    prefix: str = "",
    of: Mapping[str, str] | None = None,
) -> Iterator[Line]:
    """Yield a line per scene and per mean; without any scene of a dataset, the mean alone.

    `groups` is the order of a dataset's groups, each of which ends with its mean, or else (`group_means`) the
    last row is bold. `prefix` starts each section's name; `of` are fields of all keys.
    """
    members = scene_groups(dataset)

    def of_scene(scene: str, *section: str, bold: bool = False) -> Line:
        heading = ", ".join(filter(None, (prefix, *section)))
        return Line((scene_title(scene),), {"scene": scene, **(of or {})}, heading, scene in MEANS, bold)

    left = numbers.scenes(dataset)
    for group in groups if members else ():
        own = [scene for scene in left if scene in members[group]]
        left = [scene for scene in left if scene not in own]
        for name in (*own, *([group] if own and group_means else [])):
            yield of_scene(name, _GROUPS[group])
    for scene in left:
        yield of_scene(scene, "other scenes" if members else "")
    yield of_scene(MEAN, "all scenes" if members and prefix else "", bold=not group_means)


def _has_floor(numbers: Numbers, dataset: str) -> bool:
    """Return whether a single triangle was timed."""
    return any(
        number.value is not None
        for key, number in numbers.values.items()
        if (key.dataset, key.scene) == (dataset, FLOOR)
    )


def _floor_lines(numbers: Numbers, dataset: str) -> list[Line]:
    """Return the line of a single triangle, if one was timed."""
    known = _has_floor(numbers, dataset)
    return [Line((scene_title(FLOOR),), {"scene": FLOOR}, "one triangle")] if known else []


def native_summary(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return what the methods reach with their own renderers; the best method of a dataset is bold."""
    return make_table(
        numbers,
        paper,
        "native_summary",
        "Non-Engine results: each method with its own renderer, means over the scenes of a dataset.",
        ("Dataset", "Method"),
        metric_columns((*QUALITY, *_NATIVE)),
        native_lines(numbers, of_asset=OF_ASSET),
        {"scene": MEAN, "condition": "non_engine"},
        best_of=("dataset",),
    )


def renderer_comparison(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return a row per condition and metric, a column per method; each method's best condition is bold."""
    conditions = numbers.conditions(dataset)
    return make_table(
        numbers,
        paper,
        f"renderer_comparison-{slug(dataset)}",
        f"{dataset_title(dataset)}: the same models in their own renderer and deployed, means over "
        "scenes. Bold: a method's best condition.",
        ("Condition", "Drawn", "Metric"),
        [
            Column(method_title(method), (), {"method": method})
            for method in numbers.methods(dataset, *conditions)
        ],
        [
            Line(
                (
                    condition_title(condition),
                    f"by {by}" if (by := numbers.drawn_by.get(dataset, {}).get(condition)) else NOT_THERE,
                    title(metric),
                ),
                {"condition": condition, "metric": metric},
            )
            for condition in conditions
            for metric in (*QUALITY, "fps")
        ],
        {"dataset": dataset, "scene": MEAN},
        best_of=("method",),
    )


def scene_comparison(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return deployed condition x method of a dataset of few scenes, a block per scene.

    In each scene the best of a method's deployments is bold.
    """
    scenes = [*numbers.scenes(dataset), MEAN]
    return make_table(
        numbers,
        paper,
        f"scene_comparison-{slug(dataset)}",
        f"{dataset_title(dataset)}: Dedicated and Standard deployment per scene. Bold: the better of a "
        "method's deployments.",
        ("Condition", "Method"),
        [
            column
            for scene in scenes
            for column in metric_columns((*QUALITY, "fps"), scene_title(scene), scene=scene)
        ],
        _deployment_lines(numbers, dataset),
        {"dataset": dataset},
        best_of=("method", "scene"),
    )


def per_scene(numbers: Numbers, dataset: str, condition: str) -> Table:
    """Return every scene of a dataset in one condition, a block per method; the best method is bold."""
    chamfer = ("chamfer",) if (dataset, condition) == ("dtu", "non_engine") else ()
    drawn = numbers.methods(dataset, condition)
    return make_table(
        numbers,
        None,
        f"scenes-{slug(dataset)}-{slug(condition)}",
        f"{dataset_title(dataset)}, {condition_title(condition)}: every scene. Bold: the best method.",
        ("Scene",),
        [
            column
            for method in numbers.methods(dataset, condition, of_asset=chamfer)
            for column in metric_columns(
                (*QUALITY, "fps", *chamfer) if method in drawn else chamfer,
                method_title(method),
                method=method,
            )
        ],
        _scene_lines(numbers, dataset),
        {"dataset": dataset, "condition": condition},
        best_of=("scene",),
    )


def latency(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return P50 and P95 per scene of every deployment."""
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    columns = [
        Column(
            METRICS[metric].title,
            (f"{condition_title(condition)} (ms ↓)", method_title(method)),
            {"condition": condition, "method": method, "metric": metric},
        )
        for condition, method in pairs
        for metric in _TIMES
    ]
    return make_table(
        numbers,
        paper,
        f"latency-{slug(dataset)}",
        f"{dataset_title(dataset)}: device time of a frame per scene, ms; lower is better.",
        ("Scene",),
        columns,
        [*_scene_lines(numbers, dataset), *_floor_lines(numbers, dataset)],
        {"dataset": dataset},
        definitions=(TIME_NOTE, FLOOR_NOTE),
        notes=omitted,
    )


def frame_time(numbers: Numbers, dataset: str) -> Table:
    """Return where the time of a frame goes: on the device, between its commands, on the host."""
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    return make_table(
        numbers,
        None,
        f"frame_time-{slug(dataset)}",
        f"{dataset_title(dataset)}: where the time of a frame goes, means over scenes.",
        ("Condition", "Method"),
        [Column(title_with_unit(metric), (), {"metric": metric}) for metric in _PARTS],
        [line(condition=condition, method=method) for condition, method in pairs],
        {"dataset": dataset, "scene": MEAN},
        definitions=(TIME_NOTE, *PARTS_NOTES),
        notes=omitted,
    )


def walk(numbers: Numbers, dataset: str) -> Table:
    """Return what flickers and what is missing on a walk off the path; a method's best condition is bold."""
    pairs, omitted = _deployments(numbers, dataset, "flicker", bakes=True)
    return make_table(
        numbers,
        None,
        f"walk-{slug(dataset)}",
        f"{dataset_title(dataset)}: a walk between and beyond the cameras, means over scenes. Bold: a "
        "method's steadiest condition.",
        ("Condition", "Method"),
        [Column(title_with_unit(metric), (), {"metric": metric}) for metric in WALK],
        [line(condition=condition, method=method) for condition, method in pairs],
        {"dataset": dataset, "scene": MEAN},
        best_of=("method",),
        definitions=WALK_NOTES,
        notes=omitted,
    )


def memory(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return device memory per scene of every deployment."""
    pairs, omitted = _deployments(numbers, dataset, "memory")
    columns = []
    by_driver = False
    for condition, method in pairs:
        of = {"condition": condition, "method": method}
        group, name = (f"{condition_title(condition)} (MiB ↓)",), method_title(method)
        columns.append(Column(name, group, {**of, "metric": "memory"}))
        if numbers.value(Key(dataset, MEAN, method, condition, "driver_memory")) is not None:
            columns.append(Column(f"{name}, by the driver", group, {**of, "metric": "driver_memory"}))
            by_driver = True
    return make_table(
        numbers,
        paper,
        f"memory-{slug(dataset)}",
        f"{dataset_title(dataset)}: device memory per scene, MiB; lower is better.",
        ("Scene",),
        columns,
        [*_scene_lines(numbers, dataset), *_floor_lines(numbers, dataset)],
        {"dataset": dataset},
        definitions=(MEMORY_NOTE, *((DRIVER_NOTE,) if by_driver else ()), FLOOR_NOTE),
        notes=omitted,
    )


def runtime_resources(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return device time, memory and asset size of a dataset of few scenes, side by side."""
    blocks = {
        "Device time of a frame (ms ↓)": {metric: METRICS[metric].title for metric in _TIMES},
        "Memory (MiB ↓)": {"memory": "Render", "asset_size": METRICS["asset_size"].title},
    }
    floor = (FLOOR,) if _has_floor(numbers, dataset) else ()
    columns = [
        Column(name, (heading, scene_title(scene)), {"scene": scene, "metric": metric})
        for heading, names in blocks.items()
        for scene in (*numbers.scenes(dataset), MEAN, *floor)
        for metric, name in names.items()
        if (scene, metric) != (FLOOR, "asset_size")
    ]
    return make_table(
        numbers,
        paper,
        f"runtime_resources-{slug(dataset)}",
        f"{dataset_title(dataset)}: device time (ms), memory while drawing and size of the asset (MiB).",
        ("Condition", "Method"),
        columns,
        _deployment_lines(numbers, dataset),
        {"dataset": dataset},
        definitions=(
            TIME_NOTE,
            f"Render: {MEMORY_NOTE}; Asset: the files of the asset, the same on both tiers",
            *((FLOOR_NOTE,) if floor else ()),
        ),
    )


def _deployments(
    numbers: Numbers, dataset: str, metric: str, *, bakes: bool = False
) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    """Return the (condition, method) pairs shown, and a note on each that nothing can be shown of.

    What drawing costs of `bakes` is in a table of their own.
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


def connectivity_columns() -> list[Column]:
    """Return the columns of the diagnostics of a mesh."""
    return [column for block, metrics in _CONNECTIVITY.items() for column in metric_columns(metrics, block)]


def mesh_connectivity(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the audit of every exported mesh of a dataset, soups last. The mean is bold."""

    def is_soup(method: str) -> bool:
        mean = Key(dataset, MEAN, method, "exported_mesh", "nonmanifold_vertex_ratio")
        return SOUP in numbers.number(mean).notes

    methods = sorted(numbers.methods(dataset, "exported_mesh"), key=is_soup)
    who = "" if len(methods) != 1 else f" of {method_title(methods[0])}"
    return make_table(
        numbers,
        paper,
        f"mesh_connectivity-{slug(dataset)}",
        f"{dataset_title(dataset)}: the structure of the exported meshes{who}, as stored.",
        ("Scene",),
        connectivity_columns(),
        [
            own
            for method in methods
            for own in _scene_lines(
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
