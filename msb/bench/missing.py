"""What a dry run finds missing: each thing once, with the number of cells that need it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from msb.adapters.locate import locate
from msb.asset import is_asset
from msb.base.extras import need_extra
from msb.base.files import regular_file
from msb.bench.inputs import scan_files
from msb.bench.models import method_of
from msb.bench.protocol_tables import AUTO, PLACE, REFERENCE
from msb.bench.quality import image_measures
from msb.bench.records import Reason
from msb.bench.renders import check_size, stored_size
from msb.errors import InputError, MsbError, UsageError
from msb.metrics.registry import modules_needed
from msb.render.backend import what_is_missing

if TYPE_CHECKING:
    from msb.bench.plan import Pair, Planned, Planner
    from msb.bench.protocol import ProtocolFile
    from msb.scenes.datasets import SceneAt


_ANY = "needed before any cell"
"""What that is for without which no run starts; it is told first, and a cell's own lack as its reason."""


@dataclass(frozen=True)
class Missing:
    """Something that cells need and that is not there or cannot be used."""

    code: str
    message: str
    """Which file, what is wrong with it, what it is for, and how many cells need it."""
    cells: int
    """How many cells need it; 0 if that is not known before it is there."""
    blocks: bool
    """Whether these cells cannot be computed; else they only lack a part."""


class _Need(NamedTuple):
    """What one cell needs in vain: the error, what it is about, and whether the cell cannot do without."""

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
    found: list[Planned] = []
    for one in planned:
        needs = list(search.needs(one)) if one.status in ("pending", "failed") else []
        for need in needs:
            scenes[need][one.cell.scene] += 1
        blocking = next((need for need in needs if need.blocks), None)
        if blocking is None:
            found.append(one)
        else:
            reason = Reason(code=blocking.code, message=blocking.error)
            found.append(replace(one, job=None, status="failed", reason=reason))
    told = sorted(scenes.items(), key=lambda one: one[0].what != _ANY)
    return found, [_told(need, there) for need, there in told]


def find_unknown(lost: Mapping[str, MsbError], pairs: Sequence[Pair]) -> list[Missing]:
    """Return what must be there before it is known which cells there are.

    `lost` are the datasets whose scenes could not be listed, and why.
    """
    found = [(error, f"the scenes of {name}") for name, error in lost.items()]
    for pair in pairs:
        if pair.method.name == AUTO and pair.model is not None:
            try:
                method_of(pair.model)
            except MsbError as error:
                found.append((error, f"the method of a model on {pair.scene}"))
    return [
        Missing(error.code, f"{_text(error)}; {what}, and so the number of cells, cannot be told", 0, True)
        for error, what in found
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
    for check in checks:
        try:
            check()
        except MsbError as error:
            yield error


class _Search:
    """Looks for what cells need, for each thing once."""

    def __init__(self, planner: Planner, wrong: Sequence[MsbError]) -> None:
        self.planner, self.file, self.wrong = planner, planner.file, wrong
        self.scene = cache(self._wrong_with_scene)
        self.model = cache(_wrong_with_model)
        self.renders = cache(self._wrong_with_renders)
        self.renderer = cache(_wrong_with_renderer)

    def needs(self, planned: Planned) -> Iterator[_Need]:
        """Yield what the cell needs in vain."""
        cell, protocol = planned.cell, self.file.protocol
        pair = self.planner.pairs[cell.names]
        method, names = pair.method, {"dataset": cell.dataset, "scene": cell.scene, "method": cell.method}
        at = self.planner.scene_at(pair, None, cell.method)
        no_scene = _absent(pair.path, self.file.resolve(pair.dataset.path)) or self.scene(at)
        looked: list[tuple[MsbError | None, str, bool]] = [
            (no_scene, f"photographs and cameras of {cell.dataset}", True),
        ]

        def look(template: str | None, what: str, *, blocks: bool) -> None:
            if template is not None:
                looked.append((_absent_template(self.file, template, names), what, blocks))

        if cell.condition == "non_engine" and method.non_engine != REFERENCE:
            look(method.non_engine, what := f"renderings of {cell.model_name}", blocks=True)
            if no_scene is None and method.non_engine is not None and looked[-1][0] is None:
                looked.append((self.renders(self.file.resolve(method.non_engine, **names), at), what, True))
        elif method.model is not None and pair.model is not None:
            absent = _absent_template(self.file, method.model, names)
            looked.append((absent or self.model(pair.model), f"models of {cell.model_name}", True))
        if cell.renderer is not None:
            looked.append((self.renderer(cell.renderer), f"pictures of {cell.condition_key}", True))
        if cell.condition == "non_engine":
            look(method.non_engine_timing, f"timings of {cell.model_name}'s own renderer", blocks=False)
        if cell.condition_key == cell.condition:
            look(method.training, f"training records of {cell.model_name}", blocks=False)
        if cell.condition == "exported_mesh" and cell.dataset == "dtu" and protocol.chamfer is not None:
            look(method.mesh, f"meshes of {cell.model_name} for the Chamfer distance", blocks=False)
            data = self.file.resolve(protocol.chamfer.data)
            looked.append((_wrong_with_scan(data, cell.scene), "data of the Chamfer distance", False))
        looked += [(error, _ANY, True) for error in self.wrong]
        said = False
        for error, what, blocks in looked:
            if error is not None:
                said = said or blocks
                yield _Need(error.code, _text(error), what, blocks)
        if not said and planned.reason is not None:  # what only the planner knows
            yield _Need(planned.reason.code, planned.reason.message, cell.model_name, True)

    def _wrong_with_scene(self, at: SceneAt) -> MsbError | None:
        try:
            self.planner.known.scene(at)
        except MsbError as error:
            return error
        return None

    def _wrong_with_renders(self, folder: Path, at: SceneAt) -> MsbError | None:
        """Return what a comparison with the photographs would refuse; pixels are not decoded for it."""
        try:
            found = self.planner.known.renders(folder, at)
            for path, camera in zip(found.files, at.read().test, strict=True):
                check_size(path, stored_size(path), camera)
        except MsbError as error:
            return error
        return None


def _told(need: _Need, scenes: Mapping[str, int]) -> Missing:
    cells = sum(scenes.values())
    where = next(iter(scenes)) if len(scenes) == 1 else f"{len(scenes)} scenes"
    count = "1 cell" if cells == 1 else f"{cells} cells"
    costs = "cannot be computed" if need.blocks else "will lack a part"
    return Missing(need.code, f"{need.error}; {need.what} on {where}: {count} {costs}", cells, need.blocks)


def _text(error: MsbError) -> str:
    return str(error).removeprefix(f"{error.code}: ")


def _absent_template(file: ProtocolFile, template: str, names: Mapping[str, str]) -> MsbError | None:
    """Return that the path does not exist, where {dataset} and {scene} begin or below."""
    places = (found for found in PLACE.finditer(template) if found[1] in ("dataset", "scene"))
    place = next(places, None)
    fixed = template if place is None else template[: place.start()].rpartition("/")[0]
    return _absent(file.resolve(template, **names), file.resolve(fixed or ".", **names))


def _absent(path: Path, above: Path) -> MsbError | None:
    """Return that `path` does not exist, said of the first folder from `above` on that does not."""
    if path.exists():
        return None
    below = [place for place in path.parents if place.is_relative_to(above)]
    first = next((place for place in reversed(below) if not place.exists()), path)
    return InputError("FILE_NOT_FOUND", "there is no such file or folder", file=first)


def _wrong_with_model(path: Path) -> MsbError | None:
    try:
        if not is_asset(path):
            locate(path)
    except MsbError as error:
        return error
    return None


def _wrong_with_renderer(name: str) -> MsbError | None:
    missing = what_is_missing(name)
    return None if missing is None else UsageError("ENGINE_MISSING", f"renderer {name}: {missing}")


def _wrong_with_scan(data: Path, scene: str) -> MsbError | None:
    try:
        absent = (_absent(path, data) for path in scan_files(data, scene))
        return next((error for error in absent if error is not None), None)
    except MsbError as error:  # the scene's name is none of DTU's
        return error
