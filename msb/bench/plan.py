"""The plan of a run: its benchmark cells, the parts to compute, and the reason for each part."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

from msb.asset.tiers import why_not
from msb.base.files import file_sha256
from msb.bench.bakes import BakeTask, find_known_bake, hash_bake_inputs, make_bake_options
from msb.bench.cell import make_reason
from msb.bench.folder import Results, check_names
from msb.bench.inputs import InputReader, find_inputs
from msb.bench.job import MAIN, Job, PartInputs, PartName
from msb.bench.models import ModelAsset, ModelTask, detect_method
from msb.bench.protocol import ProtocolFile, get_overrides
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
    """A method on a scene of the protocol."""

    dataset: DatasetTable
    method: MethodTable
    scene: str
    # The folder of the scene.
    path: Path
    model: Path | None

    def task(self, root: Path, run: str) -> ModelTask | None:
        """Return the task that exports the model, or None if there is no model."""
        if self.model is None:
            return None
        label = self.method.label
        return ModelTask(root, run, self.dataset.name, self.scene, self.method.name, self.model, label)


@dataclass(frozen=True)
class Planned:
    """One benchmark cell and its pending work."""

    cell: Cell
    # The job of the benchmark cell, or None if it cannot be computed.
    job: Job | None
    # The reason for computing each part, or for making the bake (key "bake"). A reason is one of "new",
    # "failed before" and "requested", a list of changed inputs, or a fault of a record or image.
    why: Mapping[str, str] = field(default_factory=dict)
    # State "done" means that all parts are recorded and valid. Benchmark cells with the state "failed" or
    # "unsupported" have a `reason`.
    status: Literal["done", "pending", "failed", "unsupported"] = "pending"
    reason: Reason | None = None
    # The bake must finish before the parts of the benchmark cell can be planned.
    bake: BakeTask | None = None


def find_pairs(
    file: ProtocolFile, only: Sequence[str] = (), folder_errors: dict[str, MsbError] | None = None
) -> list[Pair]:
    """Return the pairs of method and scene that contain a benchmark cell selected by `only` (`is_selected`).

    If the protocol lists no scenes of a dataset, the folder of the dataset is searched. An unreadable folder
    is an error. If `folder_errors` is given, it receives the error of each unreadable dataset, and the
    dataset is skipped.
    """
    check_names(file.path.absolute(), file.results)
    variants, bakes = file.protocol.variants, file.protocol.bakes
    labels = [*(table.label for table in variants), *(table.label for table in bakes)]
    conditions = (*CONDITIONS, *file.protocol.engines, *labels)
    pairs: list[Pair] = []
    # Collect all names that `only` can select, for the error message.
    selectable: dict[str, None] = {}
    for dataset in file.protocol.datasets:
        root = file.resolve(dataset.path)
        try:
            paths = [root / name for name in dataset.scenes] or find_scenes(root)
        except MsbError as error:
            if folder_errors is None:
                raise
            folder_errors[dataset.name] = error
            continue
        for path in paths:
            for method in file.protocol.methods:
                if method.datasets and dataset.name not in method.datasets:
                    continue
                names = {"dataset": dataset.name, "scene": path.name, "method": method.name}
                model_names = (method.name, method.label) if method.label else (method.name,)
                selectable |= dict.fromkeys((dataset.name, path.name, *model_names))
                methods = (*METHODS, *model_names) if method.name == AUTO else model_names
                if _matches((dataset.name, path.name, *methods, *conditions), only):
                    model = None if method.model is None else file.resolve(method.model, **names)
                    check_names(path, model)
                    pairs.append(Pair(dataset, method, path.name, path, model))
    if only and not pairs and not folder_errors:
        raise _make_selection_error(only, (*selectable, *conditions))
    return pairs


def _make_selection_error(only: Sequence[str], names: Sequence[str]) -> UsageError:
    text = f"--only {' --only '.join(only)} selects no benchmark cell; possible words are {', '.join(names)}"
    return UsageError("USAGE", text)


class Planner:
    """Plans the benchmark cells that `only` selects. If `redo` is true, finished parts are computed again."""

    def __init__(
        self,
        file: ProtocolFile,
        run: str,
        reader: InputReader,
        only: Sequence[str] = (),
        *,
        redo: bool = False,
    ) -> None:
        self.file, self.run, self.reader, self.only, self.redo = file, run, reader, tuple(only), redo
        self.results = Results(file.results)
        self.pairs: dict[tuple[str, ...], Pair] = {}

    def plan(self, pairs: Sequence[Pair], models: Mapping[Pair, ModelAsset | Exception]) -> list[Planned]:
        """Return all selected benchmark cells in the order of the protocol.

        For each pair of method and scene, `models` contains the model, or the error that prevented reading
        the model. In a dry run, models that have not been exported count as missing.
        """
        cells = []
        for pair in pairs:
            for planned in self._plan_pair(pair, models.get(pair)):
                cell = planned.cell
                key = cell.names
                if key in self.pairs:
                    text = (
                        f"/methods: there are two models of {cell.model_name} on {cell.scene}; give one of "
                        'them a label, for example label = "ours"'
                    )
                    raise InputError("PROTOCOL_INVALID", text, file=self.file.path, pointer="/methods")
                self.pairs[key] = pair
                if is_selected(cell, self.only):
                    cells.append(planned)
        if self.only and not cells:
            names = dict.fromkeys(name for key in self.pairs for name in key)
            raise _make_selection_error(self.only, list(names))
        return cells

    def _plan_pair(self, pair: Pair, model: ModelAsset | Exception | None) -> Iterator[Planned]:
        """Yield a benchmark cell for each condition, engine, variant and bake of a method on a scene."""
        name = model.method if isinstance(model, ModelAsset) else pair.method.name
        if name == AUTO and model is None and pair.model is not None:
            with contextlib.suppress(MsbError):
                name = detect_method(pair.model)
        if name == AUTO:  # the model cannot be read, so its method and its benchmark cells are unknown
            return
        conditions = pair.method.conditions or self.file.protocol.conditions
        for condition in conditions:
            if condition == "non_engine" and pair.method.non_engine is None:
                continue
            if pair.model is None and condition != "non_engine" and lookup(name).supports("standard"):
                continue  # the protocol contains only official renderings of this method
            cell = Cell(
                dataset=pair.dataset.name,
                scene=pair.scene,
                method=name,
                label=pair.method.label,
                condition=condition,
            )
            yield self._plan_cell(pair, model, cell)
            if condition == "standard":
                for engine in self.file.protocol.engines:
                    yield self._plan_cell(pair, model, cell.model_copy(update={"renderer": engine}))
                for bake in self.file.protocol.bakes if pair.model is not None else ():
                    if not bake.datasets or cell.dataset in bake.datasets:
                        yield self._plan_bake(pair, model, bake, cell.model_copy(update={"bake": bake.label}))
            if condition == "dedicated":
                for variant in self.file.protocol.variants:
                    changes = {"variant": variant.label, "renderer": variant.renderer}
                    yield self._plan_cell(pair, model, cell.model_copy(update=changes))

    def _plan_bake(
        self, pair: Pair, model: ModelAsset | Exception | None, table: BakeTable, cell: Cell
    ) -> Planned:
        """Return the plan of a baked benchmark cell.

        If the bake does not exist yet, the plan contains its task.
        """
        if not isinstance(model, ModelAsset) or not is_selected(cell, self.only):
            return self._plan_cell(pair, model, cell)
        settings = get_overrides(pair.method)
        try:
            scene = self.scene_at(pair, model, cell.method)
            views, options = self.reader.describe_views(scene), make_bake_options(table, cell.method)
            key = hash_bake_inputs(model, options, settings, self.reader.read_scene(scene), views)
        except MsbError as error:
            return Planned(cell, None, status="failed", reason=make_reason(error))
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
        if not self.redo and (known := find_known_bake(task)) is not None:
            return self._plan_cell(pair, known, cell)
        why = "requested" if self.redo else "changed" if task.path.exists() else "new"
        return Planned(cell, None, {"bake": why}, bake=task)

    def plan_after_bake(self, cell: Cell, bake: ModelAsset | Exception) -> Planned:
        """Return the plan of a benchmark cell after its bake has finished or failed."""
        return self._plan_cell(self.pairs[cell.names], bake, cell)

    def _plan_cell(self, pair: Pair, model: ModelAsset | Exception | None, cell: Cell) -> Planned:
        """Return the plan of a benchmark cell.

        The state is unsupported, failed or done, or the plan has a job for the missing parts.
        """
        # do not read the files of a benchmark cell that is not selected
        if not is_selected(cell, self.only):
            return Planned(cell, None)
        why = self._find_unsupported(pair, model, cell)
        if why is not None:
            return Planned(cell, None, status="unsupported", reason=why)
        is_official = cell.condition == "non_engine" and pair.method.non_engine != REFERENCE
        if isinstance(model, Exception) and not is_official:
            return Planned(cell, None, status="failed", reason=make_reason(model))
        if model is None and not is_official:  # a dry run does not export models
            main = "audit" if cell.condition == "exported_mesh" else "quality"
            first = main if cell.bake is None else "bake"
            return Planned(
                cell, None, {first: "model changed" if self.results.record(cell).exists() else "new"}
            )
        try:
            job = self._make_job(pair, model if isinstance(model, ModelAsset) else None, cell)
            requested = find_inputs(job, self.reader)
        except MsbError as error:
            return Planned(cell, None, status="failed", reason=make_reason(error))
        todo = self._find_work(job, requested)
        job = replace(job, parts={part: requested[part] for part in todo}, requested=requested)
        reasons = {str(part): text for part, text in todo.items()}
        return Planned(cell, job, reasons, "pending" if todo else "done")

    def _find_unsupported(
        self, pair: Pair, model: ModelAsset | Exception | None, cell: Cell
    ) -> Reason | None:
        """Return the reason that makes a benchmark cell unsupported by the method, or None."""
        tier = TIER_OF.get(cell.condition)
        if cell.condition == "non_engine" and pair.method.non_engine != REFERENCE:
            return None
        codes = "UNSUPPORTED_METHOD" if cell.bake is None else "UNSUPPORTED_"
        if isinstance(model, MsbError) and model.code.startswith(codes):
            return make_reason(model)
        if cell.bake is not None:  # if a model has at least one tier, it can be baked
            return None
        reasons = lookup(cell.method).unsupported
        # without tiers, a method has no triangles and therefore no exported mesh
        if tier is None:
            tier = "standard" if len(reasons) == len(TIER_OF) else None
        variant = self._find_variant(cell)
        if variant is not None and (why := _find_variant_fault(variant, cell.method)):
            return Reason(code="UNSUPPORTED_OPTION", message=why)
        why = None if tier is None else reasons.get(tier)
        if isinstance(model, ModelAsset):  # Gaussians, or triangles made from Gaussians
            manifest = model.open().manifest
            if tier is None and manifest.primitive == "gaussian":
                tier = "standard"
            why = why if tier is None else why_not(manifest, tier)
        if why is None:
            return None
        return Reason(code="UNSUPPORTED_TIER", message=f"{cell.method} on tier {tier}: {why}")

    def _find_variant(self, cell: Cell) -> VariantTable | None:
        """Return the protocol table for the benchmark cell's variant, or None if the cell has no variant."""
        tables = (table for table in self.file.protocol.variants if table.label == cell.variant)
        return next(tables, None)

    def _make_job(self, pair: Pair, model: ModelAsset | None, cell: Cell) -> Job:
        """Return a job for a benchmark cell, without the parts to compute."""
        protocol, method = self.file.protocol, pair.method
        names = {"dataset": cell.dataset, "scene": cell.scene, "method": cell.method}

        def path(template: str | None) -> Path | None:
            return None if template is None else self.file.resolve(template, **names)

        scene = self.scene_at(pair, model, cell.method)
        trained = tuple(
            self.reader.find_training_differences(
                model, scene, pair.model or path(method.non_engine), held_out=method.held_out
            )
            if model is not None or pair.model is None  # a dry run does not read models
            else ()
        )
        renders = path(method.non_engine) if cell.condition == "non_engine" else None
        variant = self._find_variant(cell)
        # A bake has already applied the settings, so the baked mesh does not need them.
        changes = {} if variant is None else get_overrides(variant)
        settings = {} if cell.bake else get_overrides(method) | changes
        chamfer = protocol.chamfer
        return Job(
            root=self.results.root,
            run=self.run,
            cell=cell,
            scene=scene,
            views=self.reader.describe_views(scene),
            parts={},
            model=model,
            settings=settings,
            options={} if variant is None else variant.options,
            renders=None if method.non_engine == REFERENCE else renders,
            training=path(method.training),
            mesh=path(method.mesh),
            renderer_timing=path(method.non_engine_timing) if cell.condition == "non_engine" else None,
            device=protocol.device,
            vgg_weights=self.file.vgg_weights,
            timing=protocol.timing,
            chamfer=chamfer and chamfer.model_copy(update={"data": str(path(chamfer.data))}),
            walk=protocol.walk if _is_walked(protocol.walk, cell) else None,
            trial=protocol.trial if cell.condition == "exported_mesh" or cell.bake else None,
            trained=trained,
        )

    def scene_at(self, pair: Pair, model: ModelAsset | None, method: str) -> SceneAt:
        """Return the scene for a pair of method and scene.

        Options of the method take precedence over options of the dataset.
        """

        def option(name: str) -> Any:
            value = getattr(pair.method, name)
            return getattr(pair.dataset, name) if value is None else value

        names = ("image_folder", "resolution", "background", "camera_convention")
        return scene_at(
            pair.path,
            pair.dataset.name,
            method,
            official_background=None if model is None else model.background,
            **{name: option(name) for name in names},
        )

    def _find_work(self, job: Job, requested: Mapping[PartName, PartInputs]) -> dict[PartName, str]:
        """Return the parts to compute, each with the reason."""
        invalid: str | None = None
        old: Result | None = None
        try:
            old = self.results.read(job.cell)
        except MsbError as error:
            if error.code != "FILE_NOT_FOUND":
                invalid = f"invalid record: {error.message}"
                self.reader.warnings[f"warning: {error}; the cell is computed again"] = None
        reasons: dict[PartName, str] = {}
        for part, inputs in requested.items():
            why = "requested" if self.redo else invalid or _find_change(part, inputs, old)
            if why is None and part == "quality" and old is not None:
                why = _find_changed_image(job.folder, old)
            if why is not None:
                reasons[part] = why
        return reasons


def _is_walked(table: WalkTable | None, cell: Cell) -> bool:
    """Return whether the protocol has a walk for a benchmark cell."""
    if table is None or cell.condition not in WALKED:
        return False
    return not table.conditions or cell.condition_name in table.conditions


def _find_variant_fault(variant: VariantTable, method: str) -> str | None:
    """Return the reason why a method does not support a variant, or None."""
    if lacks := variant.settings.keys() - lookup(method).settings.keys():
        return f"the variant changes {', '.join(sorted(lacks))}, which is not a setting of {method}"
    if variant.renderer is not None and "dedicated" not in getattr(
        find_renderer(variant.renderer), "tiers", TIERS
    ):
        return f"{variant.renderer} does not draw the dedicated tier"
    return None


def _find_change(part: PartName, inputs: PartInputs, old: Result | None) -> str | None:
    """Return the reason for computing a part. If the record of the part is valid, return None."""
    if old is None:
        return "new"
    recorded = old.inputs.get(part)
    if recorded is None:
        failed = part in old.reasons or (old.status == "failed" and part in MAIN)
        return "failed before" if failed else "new"
    changed = [name for name in {**recorded, **inputs} if recorded.get(name) != inputs.get(name)]
    return f"{', '.join(changed)} changed" if changed else None


def _find_changed_image(folder: Path, old: Result) -> str | None:
    """Return the first missing or changed rendering as text, or None."""
    if old.quality is None:
        return "images are not recorded"
    for image in old.quality.images:
        try:
            if not (folder / image.file).is_file():
                return f"{image.file} is missing"
            if file_sha256(folder / image.file) != image.sha256:
                return f"{image.file} changed"
        except (MsbError, OSError) as error:
            return f"{image.file}: {error}"
    return None


def is_selected(cell: Cell, only: Sequence[str]) -> bool:
    """Return whether `only` selects a benchmark cell.

    A string of `only` contains patterns separated by slashes, such as "two_dts/garden". A pattern may contain
    ``*`` and ``?``. A string selects a benchmark cell if each pattern matches the cell's dataset, scene,
    method, label, condition, variant or renderer. A cell is selected if at least one string matches. If
    `only` is empty, every benchmark cell is selected.
    """
    return _matches((*cell.names, cell.method, cell.condition), only)


def _matches(names: Sequence[str], only: Sequence[str]) -> bool:
    """Return whether at least one string of `only` matches the names of a benchmark cell."""
    return not only or any(
        all(any(fnmatchcase(name, pattern) for name in names) for pattern in text.split("/")) for text in only
    )
