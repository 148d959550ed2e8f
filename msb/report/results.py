"""Result records from results folders: they are found, read, and refused where they cannot be compared."""

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
    """An asset and its scene."""

    dataset: str
    scene: str
    method: str


@dataclass(frozen=True)
class Loaded:
    """A record, its file, and the results folder of that file."""

    result: Result
    path: Path
    root: Path
    # What tells the model from one of the same name in another folder.
    folder: str = ""

    @property
    def place(self) -> Place:
        """The asset and scene it is of."""
        dataset, scene, model, _ = self.result.cell.names
        return Place(dataset, scene, f"{model}, {self.folder}" if self.folder else model)

    @property
    def images(self) -> tuple[ImageQuality, ...]:
        """The images that were compared, none where there were none."""
        return () if self.result.quality is None else self.result.quality.images

    def changed(self, image: ImageQuality) -> Path | None:
        """Return the file of a rendering if it is there and not the one that was compared."""
        path = self.file(image.file)
        if path is None:
            return None
        try:
            return None if file_sha256(path) == image.sha256 else path
        except MsbError:
            return path

    def file(self, name: str) -> Path | None:
        """Return a file the record names relative to itself, if it is there and inside the results folder."""
        try:
            path = (self.path.parent / name).resolve()
            inside = path.is_relative_to(self.root.resolve()) and path.is_file()
        except (OSError, ValueError):  # a NUL in the name, a name too long
            return None
        return path if inside else None


@dataclass(frozen=True)
class ResultSet:
    """Records by asset and condition, and notes on records that were mixed."""

    places: Mapping[Place, Mapping[str, Loaded]]
    notes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[Loaded]:
        return (loaded for conditions in self.places.values() for loaded in conditions.values())

    def __len__(self) -> int:
        return sum(len(conditions) for conditions in self.places.values())

    @property
    def roots(self) -> list[Path]:
        """The results folders."""
        return list(dict.fromkeys(loaded.root for loaded in self))


def read_results(*folders: str | os.PathLike[str], allow_mixed: bool = False) -> ResultSet:
    """Return the records below ``FOLDER/cells`` of every results folder.

    If two folders hold the same cell, and measured the same, the later one's counts. With `allow_mixed`
    records that differ in what must be equal are taken, and noted, instead of refused; models whose records
    in two folders differ are kept apart, under the folders' names.
    """
    records = [loaded for folder in folders for loaded in _read_folder(given_path(folder))]
    return result_set(records, allow_mixed=allow_mixed)


def result_set(records: Sequence[Loaded], *, allow_mixed: bool = False) -> ResultSet:
    """Return records together; raises UsageError as `read_results`."""
    apart = _apart(records)
    names = _folder_names(records)
    records = [
        replace(one, folder=names[one.root]) if one.place._replace(scene="") in apart else one
        for one in records
    ]
    problems = [*apart.values(), *dict.fromkeys(_problems(records))]
    if problems and not allow_mixed:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        way = ' label one of the models in its protocol (label = "ours"),' if apart else ""
        text = f"{problems[0]}{more};{way} report them apart, or give --allow-mixed"
        raise UsageError("RESULTS_MIXED", text)
    places: dict[Place, dict[str, Loaded]] = {}
    for loaded in sorted(records, key=lambda loaded: condition_order(loaded.result.cell.condition_key)):
        places.setdefault(loaded.place, {})[loaded.result.cell.condition_key] = loaded
    return ResultSet(places, (*(f"mixed: {problem}" for problem in problems), *_not_installed(records)))


def _not_installed(found: Iterable[Loaded]) -> Iterator[str]:
    """Yield a note on each metric of a package that was there when something was measured, and is not now."""
    counts = Counter(key for one in found if (held := one.result.quality) for key in held.not_installed)
    for key, count in sorted(counts.items()):
        records = "a record has" if count == 1 else f"{count} records have"
        yield f"{records} a metric {key}, whose package is not installed here: its values are left out"


def _read_folder(root: Path) -> list[Loaded]:
    check_folder(root, "folder of results")
    files = Results(root).records()
    if not files:
        text = "there is no result in it: no cells/DATASET/SCENE/METHOD/COLUMN/result.json, as msb run writes"
        raise InputError("RESULTS_EMPTY", text, file=root)
    found = []
    for path in files:
        result = read_result(path)
        Results(root).check_place(result, path)
        found.append(Loaded(result, path, root))
    return found


def _problems(found: Iterable[Loaded]) -> Iterator[str]:
    """Yield what differs between records that stand beside each other in a table."""
    identities: dict[str, tuple[object, Loaded]] = {}
    of_place: dict[tuple[Place, str], tuple[object, Loaded]] = {}
    for loaded in found:
        result = loaded.result
        for identity in () if result.quality is None else result.quality.metrics:
            definition = defined(identity)
            first, other = identities.setdefault(str(identity.get("name")), (definition, loaded))
            if first != definition:
                yield f"{_name(loaded)} and {_name(other)} define {identity.get('name')} differently"
        for what, value in _must_agree(result).items():
            first, other = of_place.setdefault((loaded.place, what), (value, loaded))
            if first != value:
                yield f"{_name(loaded)} and {_name(other)} differ in {what}"


def _apart(found: Sequence[Loaded]) -> dict[Place, str]:
    """Return dataset and model -> what differs between two folders' records of one of its cells."""
    seen: dict[tuple[str, ...], Loaded] = {}
    differ: dict[Place, str] = {}
    named = _folder_names(found)
    for loaded in found:
        other = seen.setdefault(loaded.result.cell.names, loaded)
        one, two = _measured(other.result), _measured(loaded.result)
        what = [name for name in one.keys() & two.keys() if one[name] != two[name]]
        if what and other.root != loaded.root:
            folders = f"{named[other.root]} and {named[loaded.root]}"
            where = "/".join(loaded.result.cell.names)
            text = f"{folders} hold {where} with different {' and '.join(sorted(what))}"
            differ.setdefault(loaded.place._replace(scene=""), text)
    return differ


def _measured(result: Result) -> dict[str, object]:
    """Return what two records of one cell must agree in to be of the same thing."""
    facts: dict[str, object] = {}
    if result.renderer is not None:
        facts["settings"] = result.renderer.settings
        facts["renderer"] = (result.renderer.name, result.renderer.version, result.renderer.kind)
    if result.asset is not None and result.asset.sha256 is not None:
        facts["bytes of the asset"] = result.asset.sha256
    return facts


def _folder_names(found: Iterable[Loaded]) -> dict[Path, str]:
    """Return results folder -> the last parts of its path, as many as tell it from the others."""
    roots = list(dict.fromkeys(loaded.root.absolute() for loaded in found))
    count = 1
    while len({root.parts[-count:] for root in roots}) < len(roots):
        count += 1
    return {loaded.root: "/".join(loaded.root.absolute().parts[-count:]) for loaded in found}


def _must_agree(result: Result) -> dict[str, object]:
    facts: dict[str, object] = {}
    if result.setup is not None:
        facts["their setup (cameras, image folder, background)"] = result.setup
    if result.model_asset is not None and result.model_asset.sha256 is not None:
        facts["the asset's bytes"] = result.model_asset.sha256
    own_settings = result.cell.variant is None and result.cell.bake is None
    if result.renderer is not None and result.renderer.kind != "upstream" and own_settings:
        facts["their settings"] = result.renderer.settings
    if result.quality is not None:
        facts["their test images or sizes"] = result.quality.views
    return facts


def _name(loaded: Loaded) -> str:
    return f"{loaded.root.name}: {'/'.join(loaded.result.cell.names)}"
