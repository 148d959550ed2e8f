"""The board: what many people submitted, in one table that says of each row where it is from."""

import io
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from msb.bench.aggregate import AUDITED
from msb.bench.records import Result
from msb.bench.submission import MOST_PICTURES, Shown, Submission
from msb.errors import InputError, UsageError, shorten
from msb.metrics.identity import defined
from msb.report.collect import collect
from msb.report.layout import number_cell
from msb.report.metric_format import title_with_unit
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
from msb.report.pictures import Picture, Shot, View, views
from msb.report.report import Report, Section
from msb.report.results import Loaded, ResultSet, result_set
from msb.report.safe_names import plain_text
from msb.report.table import NOT_THERE, Cell, Column, Row, Table

THE_PAPER = "the paper"
_MESH = "exported_mesh"
_METRICS = ("fps", "p50_ms", "p95_ms", "memory", "asset_size", "nonmanifold_edge_ratio", "components")
# Hex digits of a hash in the table; the list of files has all of them.
_SHORT = 12
# Hex digits of a hash that tell apart who chose the same name: more where that is somebody's name, too.
_FEWEST, _ALL = 6, 64
_MOST_SIDE = 4096
_BLANK = frozenset("\u115f\u1160\u2800")
# Letters that show nothing, and the categories of others that do, or that are but marks on letters.
_UNSEEN = frozenset(("Cc", "Cf", "Cn", "Cs", "Me", "Mn"))


@dataclass(frozen=True)
class Board(Report):
    """A report whose one table has rows of many submissions, and a page of its own."""

    # Name on the board, which tells apart those who chose the same, and submission.
    submissions: tuple[tuple[str, Submission], ...] = ()

    page = "board.html"


def submitted_pictures(results: ResultSet) -> list[tuple[Shown, bytes]]:
    """Return the pictures that go with a submission: of each dataset the largest and a typical loss."""
    shown: list[tuple[Shown, bytes]] = []
    for dataset in dict.fromkeys(place.dataset for place in results.places):
        for view in views(results, [place for place in results.places if place.dataset == dataset]):
            of: dict[str, Any] = {
                "dataset": dataset,
                "scene": view.scene,
                "image": view.image,
                "why": view.why,
                "file": "-",
            }
            if view.gt is not None:
                shown.append((Shown(**of), view.gt.data))
            for method, shots in view.shots.items():
                for shot in shots:
                    if shot.picture is not None:
                        about = Shown(**of, method=method, condition=shot.heading, psnr=shot.psnr)
                        shown.append((about, shot.picture.data))
    return shown[:MOST_PICTURES]


def build_board(
    submissions: Sequence[Submission], *, with_paper: bool = True, pictures: bool = True
) -> Board:
    """Return the board of `submissions`, with the paper's numbers under those of the same kind.

    Raises
    ------
    UsageError
        Two of them are the same file.
    InputError
        RECORD_INVALID: a picture is none.
    """
    for one, other in pairwise(sorted(submissions, key=lambda each: each.sha256)):
        if one.sha256 == other.sha256:
            raise UsageError("USAGE", f"it is the same submission as {other.path.name}", file=one.path)
    named = tuple(zip(_names(submissions), submissions, strict=True))
    loaded = {
        name: result_set([Loaded(record, each.path, each.path) for record in each.records], allow_mixed=True)
        for name, each in named
    }
    numbers = {name: collect(results) for name, results in loaded.items()}
    paper = paper_numbers() if with_paper else Numbers({}, of_paper=True)
    sections = (
        Section(
            "board",
            "Results",
            "Every row says whose it is, of which model and photographs, and what drew it.",
            (_results(loaded, numbers, paper),),
        ),
        Section(
            "looks",
            "What it looks like",
            "Pictures that were submitted with the numbers.",
            views=tuple(view for name, each in named for view in _views(name, each)) if pictures else (),
        ),
        Section(
            "files",
            "What was measured",
            "Hashes tell whether two rows are of the same model and photographs.",
            (_submissions(named), _files(loaded)),
        ),
    )
    several = "" if len(named) == 1 else "s"
    total = sum(map(len, loaded.values()))
    summary = f"{total} results of {len(named)} submission{several}; nothing was computed again."
    return Board(
        "MeshSplatBench board", summary, tuple(one for one in sections if one.tables or one.views), (),
        tuple(_differences(loaded)), Numbers({}), None, with_paper, named,
    )  # fmt: skip


def _names(submissions: Sequence[Submission]) -> list[str]:
    """Return what each submission is called: no two are called the same, and none as the paper is.

    Letters of other scripts that look like ours are others: the hashes in the list of files tell these apart.
    """
    count = Counter([_seen(THE_PAPER), *(_seen(_plain(each)) for each in submissions)])
    names: list[str] = []
    for digits in range(_FEWEST, _ALL + 1):
        names = [
            name if count[_seen(name := _plain(each))] == 1 else f"{name} ({each.sha256[:digits]})"
            for each in submissions
        ]
        if len(set(map(_seen, names))) == len(names):
            break
    return names


def _plain(submission: Submission) -> str:
    name = plain_text(submission.about.name).strip()
    return name if _seen(name) else submission.sha256[:_SHORT]


def _seen(name: str) -> str:
    """Return the letters that are seen of a name, of one form and case: two of the same look the same."""
    letters = (one for one in unicodedata.normalize("NFKC", name) if one not in _BLANK and not one.isspace())
    return "".join(one for one in letters if unicodedata.category(one) not in _UNSEEN).casefold()


def _results(loaded: Mapping[str, ResultSet], numbers: Mapping[str, Numbers], paper: Numbers) -> Table:
    """Return the table of all rows; the numbers of a model's mesh stand in every row of the model."""
    metrics = [*QUALITY, *_METRICS]
    rows = []
    records = {name: _by_row(results) for name, results in loaded.items()}
    for place, names in _places(numbers).items():
        dataset, scene, method, condition = place
        keys = [
            Key(dataset, scene, method, _MESH if each in AUDITED else condition, each) for each in metrics
        ]
        labels = dataset_title(dataset), scene_title(scene), method_title(method)
        for name in names:
            cells = (_bare(number_cell(key.metric, numbers[name].number(key))) for key in keys)
            words = _text(condition_title(condition)), _text(name)
            rows.append(Row(labels, (*words, *cells, *_provenance(records[name].get(place, ())))))
        theirs = [_bare(number_cell(key.metric, paper.number(key))) for key in keys]
        if any(cell.value is not None for cell in theirs):
            words = _text(condition_title(condition)), _text(THE_PAPER)
            rows.append(Row(labels, (*words, *theirs, *[_text(NOT_THERE)] * 4), paper=True))
    columns = [
        *(Column(name, filters=True) for name in ("Condition", "From")),
        *(Column(title_with_unit(metric)) for metric in metrics),
        *(Column(name) for name in ("Model", "Photographs", "msb", "Drawn by")),
    ]
    caption = "Results; the lists choose rows."
    heads = "Dataset", "Scene", "Method"
    return Table("board", caption, heads, tuple(columns), tuple(rows)).with_common_notes()


def _places(numbers: Mapping[str, Numbers]) -> dict[tuple[str, str, str, str], list[str]]:
    """Return dataset, scene or mean, method and condition -> who has numbers there, in the table's order."""
    found: dict[tuple[str, str, str, str], list[str]] = {}
    for name, own in numbers.items():
        # A mean over one scene says nothing more than the scene.
        scenes = {(key.dataset, key.scene) for key in own.values if key.scene not in MEANS}
        count = Counter(dataset for dataset, _ in scenes)
        there = {
            key[:4] for key, number in own.values.items() if number.value is not None and not key.of_asset
        }
        drawn = {at[:3] for at in there if at[3] != _MESH}
        for at in there:
            dataset, scene, _, condition = at
            if not (scene in MEANS and count[dataset] == 1) and not (condition == _MESH and at[:3] in drawn):
                found.setdefault(at, []).append(name)
    names = dict.fromkeys(key.dataset for own in numbers.values() for key in own.values)
    datasets = {dataset: number for number, dataset in enumerate(names)}
    means = list(MEANS)

    def order(at: tuple[str, str, str, str]) -> tuple[Any, ...]:
        dataset, scene, method, condition = at
        place = means.index(scene) if scene in MEANS else -1
        return datasets[dataset], place, scene, method, condition_order(condition), condition

    return {at: found[at] for at in sorted(found, key=order)}


def _by_row(results: ResultSet) -> dict[tuple[str, str, str, str], list[Result]]:
    """Return dataset, scene or mean, method and condition -> the records there."""
    found: dict[tuple[str, str, str, str], list[Result]] = {}
    for one in results:
        dataset, scene, method = one.place
        for row in dict.fromkeys((scene, *MEANS)):
            place = dataset, row, method, one.result.cell.condition_key
            found.setdefault(place, []).append(one.result)
    return found


def _bare(cell: Cell) -> Cell:
    """Return a cell without the reasons why it is empty: most rows of a board have many."""
    return cell if cell.value is not None else replace(cell, reason=None, notes=())


def _text(text: str) -> Cell:
    return Cell(text, text)


def _provenance(held: Sequence[Result]) -> tuple[Cell, ...]:
    """Return the cells on model, photographs, version and device of one record, or of those of a mean."""
    said: list[set[str]] = [set(), set(), set(), set()]
    for one in held:
        said[0] |= {one.asset.sha256[:_SHORT]} if one.asset and one.asset.sha256 else set()
        said[1] |= {one.inputs.get("quality", {}).get("photographs", "")[:_SHORT]} - {""}
        said[2] |= {plain_text(one.tool_version)}
        said[3] |= {_device(one)} - {""}
    return tuple(
        _text(next(iter(own)) if len(own) == 1 else f"{len(own)} different" if own else NOT_THERE)
        for own in said
    )


def _device(result: Result) -> str:
    drawn = str(result.drawn_on.get("name", ""))
    if result.renderer is not None and result.renderer.kind in ("upstream", "msb_reference"):
        return "its own renderer" if result.renderer.kind == "upstream" else "our NumPy renderer"
    return shorten(plain_text(drawn), 60)


def _submissions(named: Sequence[tuple[str, Submission]]) -> Table:
    names = ("Results", "msb", "SHA-256 of the submission", "SHA-256 of msb's code", "Drawn by")
    rows = []
    for name, each in named:
        devices = ", ".join(dict.fromkeys(filter(None, map(_device, each.records)))) or NOT_THERE
        cells = [str(len(each.records)), plain_text(each.about.tool_version), each.sha256]
        rows.append(Row((name,), tuple(map(_text, (*cells, each.about.code_sha256, devices)))))
    note = "hashes say that a file is whole and which one it is, not who made it"
    return Table(
        "submissions", "Who submitted what.", ("From",), tuple(map(Column, names)), tuple(rows), (note,)
    )


def _files(loaded: Mapping[str, ResultSet]) -> Table:
    rows = []
    for name, results in loaded.items():
        for place, own in results.places.items():
            held = [one.result for one in own.values()]
            files = {
                kind: {file.sha256 for one in held if (file := getattr(one, kind)) and file.sha256}
                for kind in ("asset", "checkpoint", "renders")
            }
            photographs = {one.inputs.get("quality", {}).get("photographs") for one in held} - {None}
            model = (
                f"{dataset_title(place.dataset)}, {scene_title(place.scene)}, {method_title(place.method)}"
            )
            cells = (
                ", ".join(sorted(map(str, each))) or NOT_THERE for each in (*files.values(), photographs)
            )
            rows.append(Row((name, model), tuple(map(_text, cells))))
    names = ("Asset", "Checkpoint", "Own renderings", "Photographs")
    caption = "SHA-256 of the files; of photographs, a hash of theirs and of how they are compared."
    return Table("files", caption, ("From", "Model"), tuple(map(Column, names)), tuple(rows))


def _differences(loaded: Mapping[str, ResultSet]) -> Iterator[str]:
    """Yield what makes rows of one submission, or of several, not comparable."""
    yield from (f"{name}: {note}" for name, results in loaded.items() for note in results.notes)
    photographs: dict[tuple[str, str, str], dict[str, list[str]]] = {}
    metrics: dict[str, dict[str, list[str]]] = {}
    for name, results in loaded.items():
        for one in results:
            key = one.result.inputs.get("quality", {}).get("photographs")
            if key:
                where = (
                    dataset_title(one.place.dataset),
                    scene_title(one.place.scene),
                    method_title(one.place.method),
                )
                photographs.setdefault(where, {}).setdefault(key, []).append(name)
            for identity in () if one.result.quality is None else one.result.quality.metrics:
                text = str(sorted(defined(identity).items()))
                metrics.setdefault(str(identity.get("name")), {}).setdefault(text, []).append(name)
    alike: dict[str, list[str]] = {}
    for where, kinds in photographs.items():
        if len(kinds) > 1:
            who = " and ".join(" with ".join(dict.fromkeys(names)) for names in kinds.values())
            alike.setdefault(who, []).append(", ".join(where))
    for who, places in alike.items():
        yield f"not on the same photographs, size or background: {who}, of {'; '.join(places)}"
    for metric, kinds in metrics.items():
        if len(kinds) > 1:
            who = " and ".join(" with ".join(dict.fromkeys(names)) for names in kinds.values())
            yield f"{plain_text(metric)} is defined differently by {who}"


def _views(name: str, submission: Submission) -> Iterator[View]:
    """Yield the pictures of a submission, each checked to be one, and to have the PSNR of its record."""
    compared = {
        (*record.cell.names[:3], condition_title(record.cell.condition_key), image.name, image.values["psnr"])
        for record in submission.records
        for image in (() if record.quality is None else record.quality.images)
    }
    grouped: dict[tuple[str, str, str, str], list[Shown]] = {}
    for one in submission.about.pictures:
        grouped.setdefault((one.dataset, one.scene, one.image, one.why), []).append(one)
    for number, ((dataset, scene, image, why), shown) in enumerate(grouped.items()):
        own = {one.file: _picture(one, submission, number) for one in shown}
        truth = next((own[one.file] for one in shown if one.method is None), None)
        shots: dict[str, list[Shot]] = {}
        for one in shown:
            if one.method is not None:
                heading = str(one.condition)
                if (dataset, scene, one.method, heading, image, one.psnr) not in compared:
                    text = f"the PSNR of {one.file} is that of none of its records"
                    raise InputError("RECORD_INVALID", text, file=submission.path)
                shots.setdefault(one.method, []).append(Shot(plain_text(heading), one.psnr, own[one.file]))
        said = f"{plain_text(why)}; from {name}"
        yield View(dataset, scene, image, said, truth, {key: tuple(each) for key, each in shots.items()})


def _picture(shown: Shown, submission: Submission, number: int) -> Picture:
    from PIL import Image

    data = submission.pictures[shown.file]
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG",)) as file:
            right = max(file.size) <= _MOST_SIDE
            if right:
                file.load()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        right = False
    if not right:
        text = f"{shown.file} is no JPEG of at most {_MOST_SIDE} pixels a side"
        raise InputError("RECORD_INVALID", text, file=submission.path)
    return Picture(f"{submission.sha256[:_SHORT]}-{number}-{shown.file.rpartition('/')[2]}", data)
