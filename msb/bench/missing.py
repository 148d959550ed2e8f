"""What a dry run finds missing: each thing once, with the number of cells that need it."""

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
from msb.bench.inputs import scan_files
from msb.bench.models import method_of
from msb.bench.plan import Pair, Planned, Planner
from msb.bench.protocol import ProtocolFile
from msb.bench.protocol_tables import AUTO, PLACE, REFERENCE
from msb.bench.quality import image_measures
from msb.bench.records import Reason
from msb.bench.renders import check_size, stored_size
from msb.errors import InputError, MsbError, UsageError
from msb.metrics.registry import modules_needed
from msb.render.backend import what_is_missing
from msb.scenes.datasets import SceneAt

# What those things are for without which no run starts; they come first.
_ANY = "needed before any cell"


@dataclass(frozen=True)
class Missing:
    """Something that cells need and that is not there or cannot be used."""

    code: str
    # Which file, what is wrong with it, what it is for, and how many cells need it.
    message: str
    # How many cells need it; 0 if that is not known before it is there.
    cells: int
    # Whether these cells cannot be computed; else they only lack a part.
    blocks: bool


class _Need(NamedTuple):
    """A missing input of one cell: the error, what it is about, and whether the cell cannot do without."""

    code: str
    error: str
    what: str
    blocks: bool


def find_missing(
    planner: Planner, planned: Sequence[Planned], wrong: Sequence[MsbError] = ()
) -> tuple[list[Planned], list[Missing]]:
    """Return the plan, in which cells that lack something have failed, and all that is missing.

    Everything that a cell needs is looked for, so one missing thing hides no other. Scenes are read without
    their pixels, models are only located. `wrong` are the errors for which a run would not start.
    """
    search = _Search(planner, wrong)
    scenes: dict[_Need, Counter[str]] = defaultdict(Counter)
    cells: list[Planned] = []
    for one in planned:
        needs = search.needs(one) if one.status in ("pending", "failed") else []
        for need in needs:
            scenes[need][one.cell.scene] += 1
        blocking = next((need for need in needs if need.blocks), None)
        if blocking is None:
            cells.append(one)
        else:
            reason = Reason(code=blocking.code, message=blocking.error)
            cells.append(replace(one, job=None, status="failed", reason=reason))
    missing = sorted(scenes.items(), key=lambda item: item[0].what != _ANY)
    return cells, [_missing(need, where) for need, where in missing]


def find_unknown(lost: Mapping[str, MsbError], pairs: Sequence[Pair]) -> list[Missing]:
    """Return what must be there before it is known which cells there are.

    `lost` are the datasets whose scenes could not be listed, and why.
    """
    errors = [(error, f"the scenes of {name}") for name, error in lost.items()]
    for pair in pairs:
        if pair.method.name == AUTO and pair.model is not None:
            try:
                method_of(pair.model)
            except MsbError as error:
                errors.append((error, f"the method of a model on {pair.scene}"))
    return [
        Missing(error.code, f"{_text(error)}; {what}, and so the number of cells, cannot be told", 0, True)
        for error, what in errors
    ]


def start_errors(file: ProtocolFile, note: Callable[[str], None]) -> Iterator[MsbError]:
    """Yield why a run does not start: a missing extra, or weights that its protocol names.

    `note` is called with what is to be known about the weights.
    """
    weights = file.protocol.metrics.vgg_weights
    place = None if weights is None else file.resolve(weights)

    def load() -> None:
        for warning in () if place is None else image_measures(place).warnings:
            note(f"{warning.code}: {warning.message}")

    checks: list[Callable[[], object]] = [
        lambda: need_extra("bench", "filelock", *modules_needed(), what="a run")
    ]
    if file.protocol.videos is not None:
        checks.append(lambda: need_extra("video", "av", what="[videos]"))
    if place is not None:  # without its extra, loading does not come to look for the file
        checks += [load, lambda: regular_file(place)]
    yield from filter(None, map(_error_of, checks))


def _error_of(check: Callable[..., object], *arguments: object) -> MsbError | None:
    try:
        check(*arguments)
    except MsbError as error:
        return error
    return None


class _Search:
    """Looks for what cells need, for each thing once."""

    def __init__(self, planner: Planner, wrong: Sequence[MsbError]) -> None:
        self.planner, self.file, self.wrong = planner, planner.file, wrong
        self.error_of = cache(_error_of)

    def needs(self, planned: Planned) -> list[_Need]:
        """Return what the cell needs and lacks."""
        needs = [
            _Need(error.code, _text(error), what, blocks)
            for error, what, blocks in self.looked_for(planned)
            if error is not None
        ]
        if planned.reason is not None and not any(need.blocks for need in needs):  # only the planner knows it
            reason = planned.reason
            needs.append(_Need(reason.code, reason.message, planned.cell.model_name, True))
        return needs

    def looked_for(self, planned: Planned) -> Iterator[tuple[MsbError | None, str, bool]]:
        """Yield what is wrong with each thing that the cell needs, what it is, and whether it is blocked."""
        cell, chamfer = planned.cell, self.file.protocol.chamfer
        pair = self.planner.pairs[cell.names]
        method, model = pair.method, cell.model_name
        names = {"dataset": cell.dataset, "scene": cell.scene, "method": cell.method}
        at = self.planner.scene_at(pair, None, cell.method)

        def absent(template: str | None) -> MsbError | None:
            return None if template is None else _error_of(_check_template, self.file, template, names)

        no_scene = _error_of(_check_exists, pair.path, self.file.resolve(pair.dataset.path))
        no_scene = no_scene or self.error_of(self.planner.known.scene, at)
        yield no_scene, f"photographs and cameras of {cell.dataset}", True
        if cell.condition == "non_engine" and method.non_engine != REFERENCE:
            error = absent(method.non_engine)
            if error is None and no_scene is None and method.non_engine is not None:
                folder = self.file.resolve(method.non_engine, **names)
                error = self.error_of(self.check_renders, folder, at)
            yield error, f"renderings of {model}", True
        elif method.model is not None and pair.model is not None:
            error = absent(method.model) or self.error_of(_check_model, pair.model)
            yield error, f"models of {model}", True
        if cell.renderer is not None:
            yield self.error_of(_check_renderer, cell.renderer), f"pictures of {cell.condition_key}", True
        if cell.bake is not None:
            from msb.bake.options import BakeOptions, need_libraries

            table = next(one for one in self.file.protocol.bakes if one.label == cell.bake)
            options = BakeOptions(**table.options)
            yield self.error_of(need_libraries, options), f"bakes {cell.bake}", True
        if cell.condition == "non_engine":
            yield absent(method.non_engine_timing), f"timings of {model}'s own renderer", False
        if cell.condition_key == cell.condition:
            yield absent(method.training), f"training records of {model}", False
        if cell.condition == "exported_mesh" and cell.dataset == "dtu" and chamfer is not None:
            yield absent(method.mesh), f"meshes of {model} for the Chamfer distance", False
            error = _error_of(_check_scan, self.file.resolve(chamfer.data), cell.scene)
            yield error, "data of the Chamfer distance", False
        for error in self.wrong:
            yield error, _ANY, True

    def check_renders(self, folder: Path, at: SceneAt) -> None:
        """Refuse what a comparison with the photographs would refuse; pixels are not decoded for it."""
        renders = self.planner.known.renders(folder, at)
        for path, camera in zip(renders.files, at.read().test, strict=True):
            check_size(path, stored_size(path), camera)


def _missing(need: _Need, scenes: Mapping[str, int]) -> Missing:
    cells = sum(scenes.values())
    where = next(iter(scenes)) if len(scenes) == 1 else f"{len(scenes)} scenes"
    count = "1 cell" if cells == 1 else f"{cells} cells"
    costs = "cannot be computed" if need.blocks else "will lack a part"
    return Missing(need.code, f"{need.error}; {need.what} on {where}: {count} {costs}", cells, need.blocks)


def _text(error: MsbError) -> str:
    return str(error).removeprefix(f"{error.code}: ")


def _check_template(file: ProtocolFile, template: str, names: Mapping[str, str]) -> None:
    """Refuse a path that does not exist, where {dataset} and {scene} begin or below."""
    places = (match for match in PLACE.finditer(template) if match[1] in ("dataset", "scene"))
    place = next(places, None)
    fixed = template if place is None else template[: place.start()].rpartition("/")[0]
    _check_exists(file.resolve(template, **names), file.resolve(fixed or ".", **names))


def _check_exists(path: Path, above: Path) -> None:
    """Refuse a path that does not exist by the first folder from `above` on that does not."""
    if not path.exists():
        below = [place for place in path.parents if place.is_relative_to(above)]
        first = next((place for place in reversed(below) if not place.exists()), path)
        raise InputError("FILE_NOT_FOUND", "there is no such file or folder", file=first)


def _check_model(path: Path) -> None:
    if not is_asset(path):
        locate(path)


def _check_renderer(name: str) -> None:
    if missing := what_is_missing(name):
        raise UsageError("ENGINE_MISSING", f"renderer {name}: {missing}")


def _check_scan(data: Path, scene: str) -> None:
    for path in scan_files(data, scene):
        _check_exists(path, data)
