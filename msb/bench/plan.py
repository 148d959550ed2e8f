"""The plan of a run: every cell of the protocol, which of its parts are still to be computed, and why."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

from msb.base.files import file_sha256
from msb.bench.bakes import BakeTask, bake_key, bake_options, known_bake
from msb.bench.cell import reason_of
from msb.bench.folder import Results, check_names
from msb.bench.inputs import Known, inputs_of
from msb.bench.job import MAIN, Inputs, Job, Part
from msb.bench.models import Model, ModelTask, method_of
from msb.bench.protocol import ProtocolFile, overrides
from msb.bench.protocol_tables import (
    AUTO,
    REFERENCE,
    BakeTable,
    DatasetTable,
    MethodTable,
    VariantTable,
    WalkTable,
)
from msb.bench.records import CONDITIONS, TIER_OF, WALKED, Cell, Reason, Result
from msb.errors import InputError, MsbError, UsageError
from msb.registry import METHODS, TIERS, lookup
from msb.render.backend import find_renderer
from msb.scenes.datasets import SceneAt, find_scenes, scene_at


@dataclass(frozen=True, eq=False)
class Pair:
    """One method on one scene, as the protocol gives them."""

    dataset: DatasetTable
    method: MethodTable
    scene: str
    # The scene's folder.
    path: Path
    model: Path | None

    def task(self, root: Path, run: str) -> ModelTask | None:
        """Return the task that makes the model ready, None where there is no model."""
        if self.model is None:
            return None
        label = self.method.label
        return ModelTask(root, run, self.dataset.name, self.scene, self.method.name, self.model, label)


@dataclass(frozen=True)
class Planned:
    """One cell, and what is to be done about it."""

    cell: Cell
    # The parts to be computed; None if there is nothing to do, or nothing can be done.
    job: Job | None
    # The reason to compute each part, or to "bake": "new", "failed before", "requested", what changed, or
    # what is wrong with its record or a rendering.
    why: Mapping[str, str] = field(default_factory=dict)
    # "done" means that everything is on record and valid. "failed" and "unsupported" have a `reason`.
    status: Literal["done", "pending", "failed", "unsupported"] = "pending"
    reason: Reason | None = None
    # What must be made before the parts can be told; None where that is there, or nothing is to be made.
    bake: BakeTask | None = None


def pairs_of(
    file: ProtocolFile, only: Sequence[str] = (), lost: dict[str, MsbError] | None = None
) -> list[Pair]:
    """Return the pairs of method and scene that have a cell which `only` selects (`selected`).

    If `lost` is given, it gets the datasets whose scenes are not listed and cannot be found, by their names,
    with the error about each; else the first such error is raised.
    """
    check_names(file.path.absolute(), file.results)
    variants, bakes = file.protocol.variants, file.protocol.bakes
    labels = (*(one.label for one in variants), *(one.label for one in bakes))
    conditions = (*CONDITIONS, *file.protocol.engines, *labels)
    pairs: list[Pair] = []
    names_there: dict[str, None] = {}
    for dataset in file.protocol.datasets:
        root = file.resolve(dataset.path)
        try:
            paths = [root / name for name in dataset.scenes] or find_scenes(root)
        except MsbError as error:
            if lost is None:
                raise
            lost[dataset.name] = error
            continue
        for path in paths:
            for method in file.protocol.methods:
                if method.datasets and dataset.name not in method.datasets:
                    continue
                names = {"dataset": dataset.name, "scene": path.name, "method": method.name}
                own = (method.name, method.label) if method.label else (method.name,)
                names_there |= dict.fromkeys((dataset.name, path.name, *own))
                methods = (*METHODS, *own) if method.name == AUTO else own
                if _matches((dataset.name, path.name, *methods, *conditions), only):
                    model = None if method.model is None else file.resolve(method.model, **names)
                    check_names(path, model)
                    pairs.append(Pair(dataset, method, path.name, path, model))
    if only and not pairs and not lost:
        raise _nothing(only, (*names_there, *conditions))
    return pairs


def _nothing(only: Sequence[str], names: Sequence[str]) -> UsageError:
    text = f"--only {' --only '.join(only)} selects no cell; there are {', '.join(names)}"
    return UsageError("USAGE", text)


class Planner:
    """Turns pairs into cells: those that `only` selects, finished parts again if `redo`."""

    def __init__(
        self, file: ProtocolFile, run: str, known: Known, only: Sequence[str] = (), *, redo: bool = False
    ) -> None:
        self.file, self.run, self.known, self.only, self.redo = file, run, known, tuple(only), redo
        self.results = Results(file.results)
        self.pairs: dict[tuple[str, ...], Pair] = {}

    def plan(self, pairs: Sequence[Pair], models: Mapping[Pair, Model | Exception]) -> list[Planned]:
        """Return all selected cells in the order of the protocol.

        `models` holds the model of each pair, or the error about it; in a dry run it may be missing.
        """
        cells = []
        for pair in pairs:
            for planned in self._cells(pair, models.get(pair)):
                cell = planned.cell
                key = cell.names
                if key in self.pairs:
                    text = (
                        f"/methods: two models of {cell.model_name} on {cell.scene}; give one a label of its "
                        'own: label = "ours"'
                    )
                    raise InputError("PROTOCOL_INVALID", text, file=self.file.path, pointer="/methods")
                self.pairs[key] = pair
                if selected(cell, self.only):
                    cells.append(planned)
        if self.only and not cells:
            raise _nothing(self.only, list(dict.fromkeys(part for key in self.pairs for part in key)))
        return cells

    def _cells(self, pair: Pair, model: Model | Exception | None) -> Iterator[Planned]:
        name = model.method if isinstance(model, Model) else pair.method.name
        if name == AUTO and model is None and pair.model is not None:
            with contextlib.suppress(MsbError):
                name = method_of(pair.model)
        if name == AUTO:  # its model cannot be read, so there is no telling what it is
            return
        conditions = pair.method.conditions or self.file.protocol.conditions
        for condition in conditions:
            if condition == "non_engine" and pair.method.non_engine is None:
                continue
            if pair.model is None and condition != "non_engine" and lookup(name).supports("standard"):
                continue  # the protocol has official renderings of it only
            cell = Cell(
                dataset=pair.dataset.name,
                scene=pair.scene,
                method=name,
                label=pair.method.label,
                condition=condition,
            )
            yield self._one(pair, model, cell)
            if condition == "standard":
                for engine in self.file.protocol.engines:
                    yield self._one(pair, model, cell.model_copy(update={"renderer": engine}))
                for bake in self.file.protocol.bakes if pair.model is not None else ():
                    if not bake.datasets or cell.dataset in bake.datasets:
                        yield self._baked(pair, model, bake, cell.model_copy(update={"bake": bake.label}))
            if condition == "dedicated":
                for variant in self.file.protocol.variants:
                    own = {"variant": variant.label, "renderer": variant.renderer}
                    yield self._one(pair, model, cell.model_copy(update=own))

    def _baked(self, pair: Pair, model: Model | Exception | None, table: BakeTable, cell: Cell) -> Planned:
        """Return the cell of a bake; where that is not there, with the order to make it."""
        if not isinstance(model, Model) or not selected(cell, self.only):
            return self._one(pair, model, cell)
        settings = overrides(pair.method)
        try:
            scene = self.scene_at(pair, model, cell.method)
            views, options = self.known.views(scene), bake_options(table, cell.method)
            key = bake_key(model, options, settings, self.known.scene(scene), views)
        except MsbError as error:
            return Planned(cell, None, status="failed", reason=reason_of(error))
        task = BakeTask(
            root=self.results.root,
            run=self.run,
            names=cell.names[:3],
            model=model,
            label=table.label,
            options=options,
            settings=settings,
            scene=scene,
            views=views,
            key=key,
            device=self.file.protocol.device,
        )
        if not self.redo and (made := known_bake(task)) is not None:
            return self._one(pair, made, cell)
        why = "requested" if self.redo else "changed" if task.path.exists() else "new"
        return Planned(cell, None, {"bake": why}, bake=task)

    def with_bake(self, cell: Cell, made: Model | Exception) -> Planned:
        """Return the cell of a bake that was made, or that failed."""
        return self._one(self.pairs[cell.names], made, cell)

    def _one(self, pair: Pair, model: Model | Exception | None, cell: Cell) -> Planned:
        if not selected(cell, self.only):  # left out by `plan`, so nothing of it need be read
            return Planned(cell, None)
        why = self._unsupported(pair, model, cell)
        if why is not None:
            return Planned(cell, None, status="unsupported", reason=why)
        imported = cell.condition == "non_engine" and pair.method.non_engine != REFERENCE
        if isinstance(model, Exception) and not imported:
            return Planned(cell, None, status="failed", reason=reason_of(model))
        if model is None and not imported:  # a dry run reads no model
            main = "audit" if cell.condition == "exported_mesh" else "quality"
            first = main if cell.bake is None else "bake"
            return Planned(
                cell, None, {first: "model changed" if self.results.record(cell).exists() else "new"}
            )
        try:
            job = self._job(pair, model if isinstance(model, Model) else None, cell)
            wanted = inputs_of(job, self.known)
        except MsbError as error:
            return Planned(cell, None, status="failed", reason=reason_of(error))
        todo = self._todo(job, wanted)
        job = replace(job, parts={part: wanted[part] for part in todo}, wanted=wanted)
        reasons = {str(part): text for part, text in todo.items()}
        return Planned(cell, job, reasons, "pending" if todo else "done")

    def _unsupported(self, pair: Pair, model: Model | Exception | None, cell: Cell) -> Reason | None:
        tier = TIER_OF.get(cell.condition)
        if cell.condition == "non_engine" and pair.method.non_engine != REFERENCE:
            return None
        refusals = "UNSUPPORTED_METHOD" if cell.bake is None else "UNSUPPORTED_"
        if isinstance(model, MsbError) and model.code.startswith(refusals):
            return reason_of(model)
        if cell.bake is not None:  # of any model that something draws
            return None
        reasons = lookup(cell.method).unsupported
        if tier is None:  # an exported mesh: of anything that has triangles
            tier = "standard" if len(reasons) == len(TIER_OF) else None
        variant = self._variant(cell)
        if variant is not None and (why := _variant_problem(variant, cell.method)):
            return Reason(code="UNSUPPORTED_OPTION", message=why)
        if tier is None or tier not in reasons:
            return None
        return Reason(code="UNSUPPORTED_TIER", message=f"{cell.method} on tier {tier}: {reasons[tier]}")

    def _variant(self, cell: Cell) -> VariantTable | None:
        """Return the protocol's variant that the cell is of, None where it is of none."""
        return next((one for one in self.file.protocol.variants if one.label == cell.variant), None)

    def _job(self, pair: Pair, model: Model | None, cell: Cell) -> Job:
        protocol, method = self.file.protocol, pair.method
        names = {"dataset": cell.dataset, "scene": cell.scene, "method": cell.method}

        def path(template: str | None) -> Path | None:
            return None if template is None else self.file.resolve(template, **names)

        scene = self.scene_at(pair, model, cell.method)
        trained = () if model is None else tuple(self.known.trained(model, scene, pair.model))
        renders = path(method.non_engine) if cell.condition == "non_engine" else None
        variant = self._variant(cell)
        # A bake was made with the model's settings and, being a plain mesh, has none.
        settings = {} if cell.bake else overrides(method) | ({} if variant is None else overrides(variant))
        chamfer = protocol.chamfer
        return Job(
            root=self.results.root,
            run=self.run,
            cell=cell,
            scene=scene,
            views=self.known.views(scene),
            parts={},
            model=model,
            settings=settings,
            options={} if variant is None else variant.options,
            renders=None if method.non_engine == REFERENCE else renders,
            training=path(method.training),
            mesh=path(method.mesh),
            renderer_timing=path(method.non_engine_timing) if cell.condition == "non_engine" else None,
            device=protocol.device,
            vgg_weights=path(protocol.metrics.vgg_weights),
            timing=protocol.timing,
            chamfer=chamfer and chamfer.model_copy(update={"data": str(path(chamfer.data))}),
            walk=protocol.walk if _is_walked(protocol.walk, cell) else None,
            trial=protocol.trial if cell.condition == "exported_mesh" or cell.bake else None,
            trained=trained,
        )

    def scene_at(self, pair: Pair, model: Model | None, method: str) -> SceneAt:
        """Return how the method is evaluated on the scene: what it says, else its dataset, else the rules."""

        def option(name: str) -> Any:
            own = getattr(pair.method, name)
            return getattr(pair.dataset, name) if own is None else own

        names = ("image_folder", "resolution", "background", "camera_convention")
        return scene_at(
            pair.path,
            pair.dataset.name,
            method,
            own_background=None if model is None else model.background,
            **{name: option(name) for name in names},
        )

    def _todo(self, job: Job, wanted: Mapping[Part, Inputs]) -> dict[Part, str]:
        """Return the parts to be computed, and why."""
        bad: str | None = None
        old: Result | None = None
        try:
            old = self.results.read(job.cell)
        except MsbError as error:
            if error.code != "FILE_NOT_FOUND":
                bad = f"bad record: {error.message}"
                self.known.warnings[f"warning: {error}; the cell is computed again"] = None
        reasons: dict[Part, str] = {}
        for part, inputs in wanted.items():
            why = "requested" if self.redo else bad or _difference(part, inputs, old)
            if why is None and part == "quality" and old is not None:
                why = _image_changed(job.folder, old)
            if why is not None:
                reasons[part] = why
        return reasons


def _is_walked(wanted: WalkTable | None, cell: Cell) -> bool:
    if wanted is None or cell.condition not in WALKED:
        return False
    return not wanted.conditions or cell.condition_name in wanted.conditions


def _variant_problem(variant: VariantTable, method: str) -> str | None:
    """Return why a method has no such variant, None where it has."""
    if lacks := variant.settings.keys() - lookup(method).settings.keys():
        return f"{method} has no setting {', '.join(sorted(lacks))}, which the variant changes"
    if variant.renderer is not None and "dedicated" not in getattr(
        find_renderer(variant.renderer), "tiers", TIERS
    ):
        return f"{variant.renderer} does not draw the dedicated tier"
    return None


def _difference(part: Part, inputs: Inputs, old: Result | None) -> str | None:
    """Return why a part must be computed, None if what is on record holds."""
    if old is None:
        return "new"
    held = old.inputs.get(part)
    if held is None:
        failed = part in old.reasons or (old.status == "failed" and part in MAIN)
        return "failed before" if failed else "new"
    changed = [name for name in {**held, **inputs} if held.get(name) != inputs.get(name)]
    return f"{', '.join(changed)} changed" if changed else None


def _image_changed(folder: Path, old: Result) -> str | None:
    """Return which rendering is not the file that was compared, None if all are."""
    if old.quality is None:
        return "images not on record"
    for image in old.quality.images:
        try:
            if not (folder / image.file).is_file():
                return f"{image.file} gone"
            if file_sha256(folder / image.file) != image.sha256:
                return f"{image.file} changed"
        except (MsbError, OSError) as error:
            return f"{image.file}: {error}"
    return None


def selected(cell: Cell, only: Sequence[str]) -> bool:
    """Return whether a cell is among those asked for.

    Each text of `only` is one or more patterns (``*`` and ``?``) with slashes between; each pattern must
    match the cell's dataset, scene, method, label, condition, variant or renderer. A cell is selected if one
    text matches; if `only` is empty, every cell is selected.
    """
    return _matches((*cell.names, cell.method, cell.condition), only)


def _matches(names: Sequence[str], only: Sequence[str]) -> bool:
    return not only or any(
        all(any(fnmatchcase(name, pattern) for name in names) for pattern in text.split("/")) for text in only
    )
