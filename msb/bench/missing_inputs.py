"""List the missing inputs of a dry run, and count the benchmark cells that need each input."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

from msb.adapters.locate import locate
from msb.asset import is_asset
from msb.base.extras import need_extra
from msb.base.files import regular_file
from msb.bench.inputs import find_scan_files
from msb.bench.models import detect_method
from msb.bench.plan import Pair, Planned, Planner
from msb.bench.protocol import ProtocolFile
from msb.bench.protocol_tables import AUTO, PLACE, REFERENCE
from msb.bench.quality import load_measures
from msb.bench.records import Reason
from msb.bench.renders import check_size, measure_size
from msb.errors import InputError, MsbError, UsageError
from msb.metrics.registry import modules_needed
from msb.render.backend import why_unavailable
from msb.scenes.datasets import SceneAt

# The use of inputs that all benchmark cells need, as text.
_ANY = "needed for all cells"


@dataclass(frozen=True)
class Missing:
    """An input that is missing or invalid."""

    code: str
    # Path of the file, its fault and its use, and the number of benchmark cells that need the file.
    message: str
    # The number of benchmark cells that need the input; 0 if it is unknown.
    cells: int
    # Whether the benchmark cells cannot be computed without the input. If the value is false, only a part of
    # each record will be missing.
    blocks: bool


class _Need(NamedTuple):
    """An input file that is missing for one benchmark cell."""

    code: str
    error: str
    # The use of the input as text, such as "models of two_dts".
    use: str
    # Whether the benchmark cell cannot be computed without the input.
    blocks: bool


def find_missing(
    planner: Planner, cells: Sequence[Planned], errors: Sequence[MsbError] = ()
) -> tuple[list[Planned], list[Missing]]:
    """Return the plan and all missing inputs. A benchmark cell without a necessary input is marked as failed.

    All inputs of a benchmark cell are checked, so that one missing input does not hide another input. Scenes
    are read without photographs, and models are located without reading them. `errors` contains faults that
    affect every benchmark cell.
    """
    search = _Search(planner, errors)
    # For each missing input, count the benchmark cells of each scene that need the input.
    scenes: dict[_Need, Counter[str]] = defaultdict(Counter)
    checked: list[Planned] = []
    for planned in cells:
        needs = search.find_needs(planned) if planned.status in ("pending", "failed") else []
        for need in needs:
            scenes[need][planned.cell.scene] += 1
        blocking = next((need for need in needs if need.blocks), None)
        if blocking is None:
            checked.append(planned)
        else:
            reason = Reason(code=blocking.code, message=blocking.error)
            checked.append(replace(planned, job=None, status="failed", reason=reason))
    missing = sorted(scenes.items(), key=lambda item: item[0].use != _ANY)
    return checked, [_describe(need, counts) for need, counts in missing]


def find_unknown_cells(folder_errors: Mapping[str, MsbError], pairs: Sequence[Pair]) -> list[Missing]:
    """Return the missing folders of scenes and missing models.

    Without these inputs, the number of benchmark cells is unknown.

    `folder_errors` holds the error of each dataset whose folder of scenes cannot be read.
    """
    errors = [(error, f"the scenes of {name}") for name, error in folder_errors.items()]
    for pair in pairs:
        if pair.method.name == AUTO and pair.model is not None:
            try:
                detect_method(pair.model)
            except MsbError as error:
                errors.append((error, f"the method of a model on {pair.scene}"))
    return [
        Missing(error.code, f"{_get_text(error)}; {use} and the number of cells are unknown", 0, True)
        for error, use in errors
    ]


def find_start_errors(file: ProtocolFile, note: Callable[[str], None]) -> Iterator[MsbError]:
    """Yield the errors that prevent a run: missing extras, and missing or invalid LPIPS weights.

    `note` is called with each warning about the weights.
    """
    place = file.vgg_weights

    def load() -> None:
        for warning in () if place is None else load_measures(place).warnings:
            note(f"{warning.code}: {warning.message}")

    checks: list[Callable[[], object]] = [
        lambda: need_extra("bench", "filelock", *modules_needed(), what="a run")
    ]
    if file.protocol.videos is not None:
        checks.append(lambda: need_extra("video", "av", what="[videos]"))
    if place is not None:  # without the extra, `load` does not read the weight file, so check the file here
        checks += [load, lambda: regular_file(place)]
    yield from filter(None, map(_catch_error, checks))


def _catch_error(check: Callable[..., object], *arguments: object) -> MsbError | None:
    """Call a function. If it raises an MsbError, return the error, otherwise return None."""
    try:
        check(*arguments)
    except MsbError as error:
        return error
    return None


class _Search:
    """Checks the inputs of benchmark cells. Each input file is checked once."""

    def __init__(self, planner: Planner, errors: Sequence[MsbError]) -> None:
        self.planner, self.file, self.errors = planner, planner.file, errors
        self.catch_error = cache(_catch_error)

    def find_needs(self, planned: Planned) -> list[_Need]:
        """Return the missing inputs of a benchmark cell."""
        needs = [
            _Need(error.code, _get_text(error), use, blocks)
            for error, use, blocks in self.check_inputs(planned)
            if error is not None
        ]
        # If all necessary inputs exist, report the error that occurred during planning.
        if planned.reason is not None and not any(need.blocks for need in needs):
            reason = planned.reason
            needs.append(_Need(reason.code, reason.message, planned.cell.model_name, True))
        return needs

    def check_inputs(self, planned: Planned) -> Iterator[tuple[MsbError | None, str, bool]]:
        """Check each input of a benchmark cell.

        Yield the error or None, the use of the input as text, and whether the benchmark cell needs the input.
        """
        cell, chamfer = planned.cell, self.file.protocol.chamfer
        pair = self.planner.pairs[cell.names]
        method, model = pair.method, cell.model_name
        names = {"dataset": cell.dataset, "scene": cell.scene, "method": cell.method}
        at = self.planner.scene_at(pair, None, cell.method)

        def check_template(template: str | None) -> MsbError | None:
            return None if template is None else _catch_error(_check_template, self.file, template, names)

        # A benchmark cell needs its scene, and either a model or official renderings.
        scene_error = _catch_error(_check_exists, pair.path, self.file.resolve(pair.dataset.path))
        scene_error = scene_error or self.catch_error(self.planner.reader.read_scene, at)
        yield scene_error, f"photographs and cameras of {cell.dataset}", True
        if cell.condition == "non_engine" and method.non_engine != REFERENCE:
            error = check_template(method.non_engine)
            if error is None and scene_error is None and method.non_engine is not None:
                folder = self.file.resolve(method.non_engine, **names)
                error = self.catch_error(self.check_renders, folder, at)
            yield error, f"renderings of {model}", True
        elif method.model is not None and pair.model is not None:
            error = check_template(method.model) or self.catch_error(_check_model, pair.model)
            yield error, f"models of {model}", True
        # Engines and libraries.
        if cell.renderer is not None:
            yield self.catch_error(_check_renderer, cell.renderer), f"images of {cell.condition_key}", True
        if cell.bake is not None:
            from msb.bake.options import BakeOptions, need_libraries

            table = next(table for table in self.file.protocol.bakes if table.label == cell.bake)
            options = BakeOptions(**table.options)
            yield self.catch_error(need_libraries, options), f"bakes {cell.bake}", True
        # If an optional file is missing, only a part of the record is missing.
        if cell.condition == "non_engine":
            yield check_template(method.non_engine_timing), f"timing of the renderer of {model}", False
        if cell.condition_key == cell.condition:
            yield check_template(method.training), f"training records of {model}", False
        if cell.condition == "exported_mesh" and cell.dataset == "dtu" and chamfer is not None:
            yield check_template(method.mesh), f"meshes of {model} for the Chamfer distance", False
            error = _catch_error(_check_scan, self.file.resolve(chamfer.data), cell.scene)
            yield error, "evaluation data for the Chamfer distance", False
        for error in self.errors:
            yield error, _ANY, True

    def check_renders(self, folder: Path, at: SceneAt) -> None:
        """Check names and sizes of official renderings against the photographs, without decoding pixels."""
        renders = self.planner.reader.find_renders(folder, at)
        for path, camera in zip(renders.files, at.read().test, strict=True):
            check_size(path, measure_size(path), camera)


def _describe(need: _Need, scenes: Mapping[str, int]) -> Missing:
    """Return a missing input with its message.

    `scenes` counts the benchmark cells of each scene that need the input.
    """
    cells = sum(scenes.values())
    where = next(iter(scenes)) if len(scenes) == 1 else f"{len(scenes)} scenes"
    count = "1 cell" if cells == 1 else f"{cells} cells"
    effect = "cannot be computed" if need.blocks else "will be incomplete"
    return Missing(need.code, f"{need.error}; {need.use} on {where}: {count} {effect}", cells, need.blocks)


def _get_text(error: MsbError) -> str:
    return str(error).removeprefix(f"{error.code}: ")


def _check_template(file: ProtocolFile, template: str, names: Mapping[str, str]) -> None:
    """Raise FILE_NOT_FOUND if the path of a template does not exist.

    The error names the first folder of the path that does not exist. Therefore all scenes below this folder
    have the same error. The search starts at the folder that contains the first placeholder {dataset} or
    {scene}.
    """
    places = (match for match in PLACE.finditer(template) if match[1] in ("dataset", "scene"))
    place = next(places, None)
    fixed = template if place is None else template[: place.start()].rpartition("/")[0]
    _check_exists(file.resolve(template, **names), file.resolve(fixed or ".", **names))


def _check_exists(path: Path, above: Path) -> None:
    """Raise FILE_NOT_FOUND if `path` does not exist. The error names the outermost missing folder."""
    if not path.exists():
        below = [place for place in path.parents if place.is_relative_to(above)]
        first = next((place for place in reversed(below) if not place.exists()), path)
        raise InputError("FILE_NOT_FOUND", "this file or folder does not exist", file=first)


def _check_model(path: Path) -> None:
    if not is_asset(path):
        locate(path)


def _check_renderer(name: str) -> None:
    if missing := why_unavailable(name):
        raise UsageError("ENGINE_MISSING", f"renderer {name}: {missing}")


def _check_scan(data: Path, scene: str) -> None:
    for path in find_scan_files(data, scene):
        _check_exists(path, data)
