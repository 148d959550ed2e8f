"""Read result records from results folders, and reject records that must not be compared."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from msb.base.files import check_folder, file_sha256
from msb.base.paths import given_path
from msb.bench.folder import Results
from msb.bench.records import ImageQuality, Result, read_result
from msb.errors import InputError, MsbError, UsageError
from msb.metrics.identity import defined
from msb.report.numbers import condition_order


class Place(NamedTuple):
    """The key of an asset: its dataset, its scene, and its method (or the label of the model)."""

    dataset: str
    scene: str
    method: str


@dataclass(frozen=True)
class LoadedResult:
    """A result record with its file and its results folder."""

    result: Result
    # The file of the record, and the results folder that contains it.
    path: Path
    root: Path
    # The last parts of the path of the results folder. If two models have equal names, this text is added to
    # the names. If the name is unique, the text is "".
    folder: str = ""

    @property
    def place(self) -> Place:
        """The asset of the record."""
        dataset, scene, model, _ = self.result.cell.names
        return Place(dataset, scene, f"{model}, {self.folder}" if self.folder else model)

    @property
    def images(self) -> tuple[ImageQuality, ...]:
        """The images that were compared with photographs."""
        return () if self.result.quality is None else self.result.quality.images

    def changed_file(self, image: ImageQuality) -> Path | None:
        """Return the file of a rendering if the file exists but has changed since the comparison."""
        path = self.file(image.file)
        if path is None:
            return None
        try:
            return None if file_sha256(path) == image.sha256 else path
        except MsbError:
            return path

    def file(self, name: str) -> Path | None:
        """Return the file `name`, relative to the record, if it exists within the results folder."""
        try:
            path = (self.path.parent / name).resolve()
            inside = path.is_relative_to(self.root.resolve()) and path.is_file()
        except (OSError, ValueError):  # the name contains a NUL or is too long
            return None
        return path if inside else None


@dataclass(frozen=True)
class ResultSet:
    """Records by asset and condition. Notes explain differing records and missing metrics."""

    places: Mapping[Place, Mapping[str, LoadedResult]]
    notes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[LoadedResult]:
        return (loaded for conditions in self.places.values() for loaded in conditions.values())

    def __len__(self) -> int:
        return sum(len(conditions) for conditions in self.places.values())

    @property
    def roots(self) -> list[Path]:
        """The results folders."""
        return list(dict.fromkeys(loaded.root for loaded in self))


def read_results(*folders: str | os.PathLike[str], allow_mixed: bool = False) -> ResultSet:
    """Return the records of all results folders.

    Parameters
    ----------
    *folders : path-like
        Folders written by `msb run`. If two folders contain the same benchmark cell, the later folder counts.
    allow_mixed : bool
        Accept records that must not be compared, and add a note. With `allow_mixed`, a model with different
        records in two folders becomes two models. The names of the results folders distinguish the two
        models.

    Raises
    ------
    UsageError
        RESULTS_MIXED: records must not be compared, and `allow_mixed` is false.
    InputError
        RESULTS_EMPTY: a folder contains no record. RECORD_INVALID: a record is invalid.
    """
    records = [loaded for folder in folders for loaded in _read_folder(given_path(folder))]
    return result_set(records, allow_mixed=allow_mixed)


def result_set(records: Sequence[LoadedResult], *, allow_mixed: bool = False) -> ResultSet:
    """For each asset and condition, return the record. The errors are the errors of `read_results`."""
    conflicts = _find_conflicts(records)
    names = _shorten_folders(records)
    records = [
        replace(loaded, folder=names[loaded.root]) if loaded.place._replace(scene="") in conflicts else loaded
        for loaded in records
    ]
    problems = [*conflicts.values(), *dict.fromkeys(_find_differences(records))]
    if problems and not allow_mixed:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        label = ' give one of the models a label in its protocol (label = "ours"),' if conflicts else ""
        text = f"{problems[0]}{more};{label} report them separately, or pass --allow-mixed"
        raise UsageError("RESULTS_MIXED", text)
    places: dict[Place, dict[str, LoadedResult]] = {}
    for loaded in sorted(records, key=lambda loaded: condition_order(loaded.result.cell.condition_key)):
        places.setdefault(loaded.place, {})[loaded.result.cell.condition_key] = loaded
    return ResultSet(
        places, (*(f"mixed results: {text}" for text in problems), *_list_missing_packages(records))
    )


def _list_missing_packages(records: Iterable[LoadedResult]) -> Iterator[str]:
    """Yield a note on each recorded metric whose package is not installed."""
    qualities = [loaded.result.quality for loaded in records]
    counts = Counter(key for quality in qualities if quality for key in quality.not_installed)
    for key, count in sorted(counts.items()):
        of = "1 record" if count == 1 else f"{count} records"
        yield f"the metric {key} of {of} is omitted, because its package is not installed"


def _read_folder(root: Path) -> list[LoadedResult]:
    check_folder(root, "folder of results")
    files = Results(root).records()
    if not files:
        place = "cells/DATASET/SCENE/METHOD/CONDITION/result.json"
        text = f"the folder holds no results ({place}); pass a results folder of msb run"
        raise InputError("RESULTS_EMPTY", text, file=root)
    records = []
    for path in files:
        result = read_result(path)
        Results(root).check_place(result, path)
        records.append(LoadedResult(result, path, root))
    return records


def _find_differences(records: Iterable[LoadedResult]) -> Iterator[str]:
    """Yield differences between records that are side by side in tables."""
    identities: dict[str, tuple[object, LoadedResult]] = {}
    of_place: dict[tuple[Place, str], tuple[object, LoadedResult]] = {}
    for loaded in records:
        result = loaded.result
        # Every metric must have the same definition in all records.
        for identity in () if result.quality is None else result.quality.metrics:
            definition = defined(identity)
            first, other = identities.setdefault(str(identity.get("name")), (definition, loaded))
            if first != definition:
                both = f"{_format_name(loaded)} and {_format_name(other)}"
                yield f"{both} define {identity.get('name')} differently"
        # All conditions of an asset must be drawn and compared in the same way.
        for what, value in _collect_asset_facts(result).items():
            first, other = of_place.setdefault((loaded.place, what), (value, loaded))
            if first != value:
                yield f"{_format_name(loaded)} and {_format_name(other)} differ in {what}"


def _find_conflicts(records: Sequence[LoadedResult]) -> dict[Place, str]:
    """For each model, return the difference between records of one benchmark cell in two folders."""
    first_records: dict[tuple[str, ...], LoadedResult] = {}
    conflicts: dict[Place, str] = {}
    names = _shorten_folders(records)
    for loaded in records:
        other = first_records.setdefault(loaded.result.cell.names, loaded)
        facts, other_facts = _collect_cell_facts(loaded.result), _collect_cell_facts(other.result)
        what = [name for name in other_facts.keys() & facts.keys() if other_facts[name] != facts[name]]
        if what and other.root != loaded.root:
            folders = f"{names[other.root]} and {names[loaded.root]}"
            where = "/".join(loaded.result.cell.names)
            text = f"{folders} hold {where} with different {' and '.join(sorted(what))}"
            conflicts.setdefault(loaded.place._replace(scene=""), text)
    return conflicts


def _collect_cell_facts(result: Result) -> dict[str, object]:
    """Return the properties that must be equal in two records of the same benchmark cell."""
    facts: dict[str, object] = {}
    if result.renderer is not None:
        facts["settings"] = result.renderer.settings
        facts["renderer"] = (result.renderer.name, result.renderer.version, result.renderer.kind)
    if result.asset is not None and result.asset.sha256 is not None:
        facts["bytes of the asset"] = result.asset.sha256
    return facts


def _shorten_folders(records: Iterable[LoadedResult]) -> dict[Path, str]:
    """Return a unique short name for each results folder. The name is the end of the folder's path."""
    roots = list(dict.fromkeys(loaded.root.absolute() for loaded in records))
    count = 1
    while len({root.parts[-count:] for root in roots}) < len(roots):
        count += 1
    return {loaded.root: "/".join(loaded.root.absolute().parts[-count:]) for loaded in records}


def _collect_asset_facts(result: Result) -> dict[str, object]:
    """Return the properties that must be equal in all conditions of an asset.

    Variants may have different settings.
    """
    facts: dict[str, object] = {}
    if result.setup is not None:
        facts["setup (cameras, image folder, background)"] = result.setup
    if result.model_asset is not None and result.model_asset.sha256 is not None:
        facts["the bytes of the asset"] = result.model_asset.sha256
    is_tier = result.cell.variant is None and result.cell.bake is None
    if result.renderer is not None and result.renderer.kind != "upstream" and is_tier:
        facts["settings"] = result.renderer.settings
    if result.quality is not None:
        facts["test images or their sizes"] = result.quality.views
    return facts


def _format_name(loaded: LoadedResult) -> str:
    return f"{loaded.root.name}: {'/'.join(loaded.result.cell.names)}"
