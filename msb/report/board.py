"""The board is one table with the results of many submissions. Each row of the board names its origin."""

import io
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from msb.bench.aggregate import AUDITED
from msb.bench.records import Result
from msb.bench.submission import MOST_PICTURES, Submission, SubmittedImage
from msb.errors import InputError, UsageError, shorten
from msb.metrics.identity import defined
from msb.report.collect import collect
from msb.report.compared_views import ComparedView, JpegImage, Rendering, select_views
from msb.report.layout import number_cell
from msb.report.metric_format import metric_title_with_unit
from msb.report.numbers import (
    MEANS,
    QUALITY,
    Key,
    Numbers,
    condition_order,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.paper import paper_numbers
from msb.report.report import Report, Section
from msb.report.results import LoadedResult, ResultSet, result_set
from msb.report.safe_names import plain_text
from msb.report.table import NOT_AVAILABLE, Table, TableCell, TableColumn, TableRow

# Name that is printed as the submitter of the paper's rows.
THE_PAPER = "the paper"
_MESH = "exported_mesh"
# Columns to the right of the image quality metrics.
_METRICS = ("fps", "p50_ms", "p95_ms", "memory", "asset_size", "nonmanifold_edge_ratio", "components")
# Number of hexadecimal digits of a hash in the table of results. The table of files prints all 64 digits.
_HASH_DIGITS = 12
# Minimum and maximum number of hexadecimal digits that are added to equal names of submitters. More digits
# are used only if the names are still equal.
_MIN_NAME_DIGITS, _MAX_NAME_DIGITS = 6, 64
# Maximum width and height of a submitted image, in pixels.
_MAX_SIDE = 4096
# Invisible letters: Hangul fillers and the empty Braille pattern. Unicode categories without a visible glyph:
# controls, formatting, unassigned, surrogates, combining marks.
_BLANK_LETTERS = frozenset("\u115f\u1160\u2800")
_INVISIBLE_CATEGORIES = frozenset(("Cc", "Cf", "Cn", "Cs", "Me", "Mn"))

# Dataset, scene (or mean), method and condition of a row.
RowKey = tuple[str, str, str, str]


@dataclass(frozen=True)
class Board(Report):
    """A report with one table of many submissions.

    `submissions` contains pairs of a unique name and a submission.
    """

    submissions: tuple[tuple[str, Submission], ...] = ()

    page = "board.html"


def submitted_pictures(results: ResultSet) -> list[tuple[SubmittedImage, bytes]]:
    """Return the submitted images of a submission: their descriptions and their JPEG data.

    The images show the views with the largest and the median loss of each dataset.
    """
    pictures: list[tuple[SubmittedImage, bytes]] = []
    for dataset in dict.fromkeys(place.dataset for place in results.places):
        places = [place for place in results.places if place.dataset == dataset]
        for view in select_views(results, places):
            common: dict[str, Any] = {
                "dataset": dataset,
                "scene": view.scene,
                "image": view.view,
                "why": view.why,
                "file": "-",
            }
            if view.ground_truth is not None:
                pictures.append((SubmittedImage(**common), view.ground_truth.data))
            for method, renderings in view.renderings.items():
                for rendering in renderings:
                    if rendering.image is not None:
                        about = SubmittedImage(
                            **common, method=method, condition=rendering.heading, psnr=rendering.psnr
                        )
                        pictures.append((about, rendering.image.data))
    return pictures[:MOST_PICTURES]


def build_board(
    submissions: Sequence[Submission], *, with_paper: bool = True, pictures: bool = True
) -> Board:
    """Return the board of `submissions`, with the paper's numbers below comparable rows.

    Raises
    ------
    UsageError
        The same submission is passed twice.
    InputError
        RECORD_INVALID: a submitted image is invalid.
    """
    for submission, other in pairwise(sorted(submissions, key=lambda submission: submission.sha256)):
        if submission.sha256 == other.sha256:
            text = f"the file is the same submission as {other.path.name}; name it once"
            raise UsageError("USAGE", text, file=submission.path)
    named = tuple(zip(_name_submissions(submissions), submissions, strict=True))
    results = {
        name: result_set(
            [LoadedResult(record, submission.path, submission.path) for record in submission.records],
            allow_mixed=True,
        )
        for name, submission in named
    }
    numbers = {name: collect(of_submission) for name, of_submission in results.items()}
    paper = paper_numbers() if with_paper else Numbers({}, of_paper=True)
    views: tuple[ComparedView, ...] = ()
    if pictures:
        views = tuple(view for name, submission in named for view in _read_views(name, submission))
    sections = (
        Section(
            "board",
            "Results",
            "Each row names its submitter, model, photographs and renderer.",
            (_results_table(results, numbers, paper),),
        ),
        Section("looks", "Renderings", "Images submitted with the results.", views=views),
        Section(
            "files",
            "Files",
            "Equal hashes mean that two rows measure the same model on the same photographs.",
            (_submissions_table(named), _files_table(results)),
        ),
    )
    plural = "" if len(named) == 1 else "s"
    total = sum(map(len, results.values()))
    summary = f"{total} results of {len(named)} submission{plural}; nothing was computed again."
    return Board(
        "MeshSplatBench board",
        summary,
        sections=tuple(section for section in sections if section.tables or section.views),
        findings=(),
        notes=tuple(_find_differences(results)),
        numbers=Numbers({}),
        with_paper=with_paper,
        submissions=named,
    )


def _name_submissions(submissions: Sequence[Submission]) -> list[str]:
    """Return a unique name for each submission. The name "the paper" is never used.

    If two names look alike, digits from the hashes of the submissions are added. Letters of other scripts
    that resemble Latin letters are not recognised. The hashes in the table of files distinguish similar
    names.
    """
    plain_names = [_plain_name(submission) for submission in submissions]
    count = Counter(map(_visible_form, [THE_PAPER, *plain_names]))
    names: list[str] = []
    for digits in range(_MIN_NAME_DIGITS, _MAX_NAME_DIGITS + 1):
        names = [
            name if count[_visible_form(name)] == 1 else f"{name} ({submission.sha256[:digits]})"
            for name, submission in zip(plain_names, submissions, strict=True)
        ]
        if len(set(map(_visible_form, names))) == len(names):
            break
    return names


def _plain_name(submission: Submission) -> str:
    """Return the submitter's name on one line.

    If the name has no visible letters, return digits of the submission's hash.
    """
    name = plain_text(submission.about.name).strip()
    return name if _visible_form(name) else submission.sha256[:_HASH_DIGITS]


def _visible_form(name: str) -> str:
    """Return the visible letters of a name in lower case. Names that look alike give equal results."""
    normal = unicodedata.normalize("NFKC", name)
    letters = (letter for letter in normal if letter not in _BLANK_LETTERS and not letter.isspace())
    visible = (letter for letter in letters if unicodedata.category(letter) not in _INVISIBLE_CATEGORIES)
    return "".join(visible).casefold()


def _results_table(results: Mapping[str, ResultSet], numbers: Mapping[str, Numbers], paper: Numbers) -> Table:
    """Return a row for each scene, method, condition and submitter.

    `results` and `numbers` map the name of each submitter to its results and numbers. The mesh metrics of a
    model are repeated in all rows of the model.
    """
    metrics = [*QUALITY, *_METRICS]
    rows = []
    records = {name: _group_records(of_submitter) for name, of_submitter in results.items()}
    for row_key, names in _list_rows(numbers).items():
        dataset, scene, method, condition = row_key
        keys = [
            Key(dataset, scene, method, _MESH if metric in AUDITED else condition, metric)
            for metric in metrics
        ]
        labels = dataset_title(dataset), scene_title(scene), method_title(method)
        for name in names:
            cells = [_without_reason(number_cell(key.metric, numbers[name].number(key))) for key in keys]
            origin = _text_cell(condition_title(condition)), _text_cell(name)
            provenance = _provenance_cells(records[name].get(row_key, ()))
            rows.append(TableRow(labels, (*origin, *cells, *provenance)))
        cells = [_without_reason(number_cell(key.metric, paper.number(key))) for key in keys]
        if any(cell.value is not None for cell in cells):
            origin = _text_cell(condition_title(condition)), _text_cell(THE_PAPER)
            provenance = (_text_cell(NOT_AVAILABLE),) * 4
            rows.append(TableRow(labels, (*origin, *cells, *provenance), paper=True))
    columns = [
        *(TableColumn(name, filters=True) for name in ("Condition", "From")),
        *(TableColumn(metric_title_with_unit(metric)) for metric in metrics),
        *(TableColumn(name) for name in ("Model", "Photographs", "msb", "Drawn by")),
    ]
    caption = "Results. Use the lists to filter the rows."
    heads = "Dataset", "Scene", "Method"
    return Table("board", caption, heads, tuple(columns), tuple(rows)).with_common_notes()


def _list_rows(numbers: Mapping[str, Numbers]) -> dict[RowKey, list[str]]:
    """Return the rows of the table in order. For each row, list the submitters that have numbers for it."""
    names_of: dict[RowKey, list[str]] = {}
    for name, of_submitter in numbers.items():
        scenes = {(key.dataset, key.scene) for key in of_submitter.values if key.scene not in MEANS}
        count = Counter(dataset for dataset, _ in scenes)
        row_keys = {
            key[:4]
            for key, number in of_submitter.values.items()
            if number.value is not None and not key.is_of_asset
        }
        drawn = {row_key[:3] for row_key in row_keys if row_key[3] != _MESH}
        for row_key in row_keys:
            dataset, scene, _, condition = row_key
            # Omit the mean of a single scene. If a model also has rendered conditions, omit its exported
            # mesh.
            is_repeated_mean = scene in MEANS and count[dataset] == 1
            is_repeated_mesh = condition == _MESH and row_key[:3] in drawn
            if not is_repeated_mean and not is_repeated_mesh:
                names_of.setdefault(row_key, []).append(name)
    names = dict.fromkeys(key.dataset for of_submitter in numbers.values() for key in of_submitter.values)
    datasets = {dataset: number for number, dataset in enumerate(names)}
    means = list(MEANS)

    def order(row_key: RowKey) -> tuple[Any, ...]:
        dataset, scene, method, condition = row_key
        mean = means.index(scene) if scene in MEANS else -1  # rows with means follow the rows of scenes
        return datasets[dataset], mean, scene, method, condition_order(condition), condition

    return {row_key: names_of[row_key] for row_key in sorted(names_of, key=order)}


def _group_records(results: ResultSet) -> dict[RowKey, list[Result]]:
    """Return the records of each row. The row of a mean contains the records of all scenes."""
    records: dict[RowKey, list[Result]] = {}
    for loaded in results:
        dataset, scene, method = loaded.place
        for row in dict.fromkeys((scene, *MEANS)):
            row_key = dataset, row, method, loaded.result.cell.condition_key
            records.setdefault(row_key, []).append(loaded.result)
    return records


def _without_reason(cell: TableCell) -> TableCell:
    """Return a table cell without the reason for a missing value.

    Most cells of a board are empty, so the reasons would fill the page.
    """
    return cell if cell.value is not None else replace(cell, reason=None, notes=())


def _text_cell(text: str) -> TableCell:
    return TableCell(text, text)


def _provenance_cells(records: Sequence[Result]) -> tuple[TableCell, ...]:
    """Return four table cells: model, photographs, version and device.

    If the records have different values, the text is "N different".
    """
    models = {
        record.asset.sha256[:_HASH_DIGITS] for record in records if record.asset and record.asset.sha256
    }
    photographs = {_photographs_hash(record)[:_HASH_DIGITS] for record in records} - {""}
    versions = {plain_text(record.tool_version) for record in records}
    devices = {_device_name(record) for record in records} - {""}
    return tuple(
        _text_cell(
            next(iter(values))
            if len(values) == 1
            else f"{len(values)} different"
            if values
            else NOT_AVAILABLE
        )
        for values in (models, photographs, versions, devices)
    )


def _photographs_hash(record: Result) -> str:
    """Return a hash of the photographs and of the settings for comparing them.

    Without photographs, return "".
    """
    return str(record.inputs.get("quality", {}).get("photographs", ""))


def _device_name(record: Result) -> str:
    name = str(record.drawn_on.get("name", ""))
    if record.renderer is not None and record.renderer.kind in ("upstream", "msb_reference"):
        return "native renderer" if record.renderer.kind == "upstream" else "our NumPy renderer"
    return shorten(plain_text(name), 60)


def _submissions_table(named: Sequence[tuple[str, Submission]]) -> Table:
    names = ("Results", "msb", "SHA-256 of the submission", "SHA-256 of msb's code", "Drawn by")
    rows = []
    for name, submission in named:
        devices = dict.fromkeys(filter(None, map(_device_name, submission.records)))
        cells = (
            str(len(submission.records)),
            plain_text(submission.about.tool_version),
            submission.sha256,
            submission.about.code_sha256,
            ", ".join(devices) or NOT_AVAILABLE,
        )
        rows.append(TableRow((name,), tuple(map(_text_cell, cells))))
    note = "a hash identifies a file and shows that it is complete; it does not prove who made it"
    columns = tuple(map(TableColumn, names))
    return Table("submissions", "Submissions.", ("From",), columns, tuple(rows), (note,))


def _files_table(results: Mapping[str, ResultSet]) -> Table:
    """For each submitter and model, return the hashes of all files that the results are computed from."""
    rows = []
    for name, of_submitter in results.items():
        for place, conditions in of_submitter.places.items():
            records = [loaded.result for loaded in conditions.values()]
            hashes = [
                {file.sha256 for record in records if (file := getattr(record, kind)) and file.sha256}
                for kind in ("asset", "checkpoint", "renders")
            ]
            hashes.append({_photographs_hash(record) for record in records} - {""})
            model = (
                f"{dataset_title(place.dataset)}, {scene_title(place.scene)}, {method_title(place.method)}"
            )
            cells = (", ".join(sorted(map(str, values))) or NOT_AVAILABLE for values in hashes)
            rows.append(TableRow((name, model), tuple(map(_text_cell, cells))))
    names = ("Asset", "Checkpoint", "Native renderings", "Photographs")
    caption = "SHA-256 of the files. The hash of photographs also covers the settings of their comparison."
    return Table("files", caption, ("From", "Model"), tuple(map(TableColumn, names)), tuple(rows))


def _find_differences(results: Mapping[str, ResultSet]) -> Iterator[str]:
    """Yield the reasons that make rows of the board incomparable."""
    yield from (f"{name}: {note}" for name, of_submitter in results.items() for note in of_submitter.notes)
    # For each (dataset, scene, method), group the submitters by the hash of their photographs.
    photographs: dict[tuple[str, str, str], dict[str, list[str]]] = {}
    # For each metric, group the submitters by the definition of the metric.
    metrics: dict[str, dict[str, list[str]]] = {}
    for name, of_submitter in results.items():
        for loaded in of_submitter:
            if key := _photographs_hash(loaded.result):
                dataset, scene, method = loaded.place
                where = dataset_title(dataset), scene_title(scene), method_title(method)
                photographs.setdefault(where, {}).setdefault(key, []).append(name)
            for identity in () if loaded.result.quality is None else loaded.result.quality.metrics:
                text = str(sorted(defined(identity).items()))
                metrics.setdefault(str(identity.get("name")), {}).setdefault(text, []).append(name)
    # If several models have equal groups of submitters, write one sentence for all of them.
    places_of: dict[str, list[str]] = {}
    for where, groups in photographs.items():
        if len(groups) > 1:
            places_of.setdefault(_list_groups(groups.values()), []).append(", ".join(where))
    for submitters, places in places_of.items():
        yield f"different photographs, sizes or backgrounds: {submitters}, for {'; '.join(places)}"
    for metric, groups in metrics.items():
        if len(groups) > 1:
            yield f"different definitions of {plain_text(metric)}: {_list_groups(groups.values())}"


def _list_groups(groups: Iterable[Sequence[str]]) -> str:
    """Return groups of submitter names as text, such as "A with B and C" for the groups (A, B) and (C)."""
    return " and ".join(" with ".join(dict.fromkeys(names)) for names in groups)


def _read_views(name: str, submission: Submission) -> Iterator[ComparedView]:
    """Yield the submitted views.

    Raises InputError if an image is not a small JPEG, or if no record contains the PSNR of the image.
    """
    recorded = {
        (*record.cell.names[:3], condition_title(record.cell.condition_key), image.name, image.values["psnr"])
        for record in submission.records
        for image in (() if record.quality is None else record.quality.images)
    }
    by_view: dict[tuple[str, str, str, str], list[SubmittedImage]] = {}
    for picture in submission.about.pictures:
        by_view.setdefault((picture.dataset, picture.scene, picture.image, picture.why), []).append(picture)
    for number, ((dataset, scene, view, why), pictures) in enumerate(by_view.items()):
        images = {picture.file: _read_image(picture, submission, number) for picture in pictures}
        ground_truth = next((images[picture.file] for picture in pictures if picture.method is None), None)
        renderings: dict[str, list[Rendering]] = {}
        for picture in pictures:
            if picture.method is not None:
                heading = str(picture.condition)
                if (dataset, scene, picture.method, heading, view, picture.psnr) not in recorded:
                    text = f"no record of the view has the PSNR of {picture.file}"
                    raise InputError("RECORD_INVALID", text, file=submission.path)
                rendering = Rendering(plain_text(heading), picture.psnr, images[picture.file])
                renderings.setdefault(picture.method, []).append(rendering)
        explanation = f"{plain_text(why)}; from {name}"
        by_method = {method: tuple(row) for method, row in renderings.items()}
        yield ComparedView(dataset, scene, view, explanation, ground_truth, by_method)


def _read_image(picture: SubmittedImage, submission: Submission, number: int) -> JpegImage:
    """Return a submitted image. `number` is the index of the view.

    Raises InputError if the image is not a small JPEG.
    """
    from PIL import Image

    data = submission.pictures[picture.file]
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG",)) as file:
            valid = max(file.size) <= _MAX_SIDE
            if valid:
                file.load()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        valid = False
    if not valid:
        text = f"{picture.file} is not a JPEG of at most {_MAX_SIDE} x {_MAX_SIDE} pixels"
        raise InputError("RECORD_INVALID", text, file=submission.path)
    name = f"{submission.sha256[:_HASH_DIGITS]}-{number}-{picture.file.rpartition('/')[2]}"
    return JpegImage(name, data)
