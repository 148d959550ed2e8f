"""The protocol file (TOML), read and checked: which methods on which scenes, in which conditions, and how."""

import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from msb.api.demo import PROTOCOL, demo_folder
from msb.base.bounded_parsing import parse_toml
from msb.base.paths import given_path
from msb.bench.checked import checked, read_bytes
from msb.bench.folder import check_names
from msb.bench.protocol_tables import (
    AUTO,
    PLACE,
    PLACES,
    REFERENCE,
    BakeTable,
    MethodTable,
    Protocol,
    VariantTable,
    protocol_model,
)
from msb.bench.records import CONDITIONS, WALKED
from msb.errors import InputError, UsageError, shorten
from msb.registry import METHODS

PROTOCOL_NAME = "protocol.toml"
_MAX_BYTES = 1 << 20


@dataclass(frozen=True)
class ProtocolFile:
    """A protocol and the file it came from. Paths in it are relative to that file's folder."""

    path: Path
    # The content of the file, which is kept with the results.
    text: bytes
    protocol: Protocol
    # The results folder to use instead of the one that the file names.
    results_instead: Path | None = None

    @property
    def results(self) -> Path:
        """The results folder."""
        if self.results_instead is not None:
            return self.results_instead.absolute()
        return self.resolve(self.protocol.results)

    def resolve(self, template: str, **names: str) -> Path:
        """Return the path that `template` means: placeholders are filled from `names`, ".." is resolved."""

        def fill(found: re.Match[str]) -> str:
            return found[0][0] if found[1] is None else names.get(found[1], found[0])

        filled = PLACE.sub(fill, template)
        return Path(os.path.normpath(Path(self.path.absolute().parent, Path(filled).expanduser())))


def read_protocol(path: str | os.PathLike[str]) -> ProtocolFile:
    """Return the protocol in the TOML file `path`."""
    return parse_protocol(read_bytes(path, _MAX_BYTES, "PROTOCOL_INVALID"), path)


def parse_protocol(text: bytes, path: str | os.PathLike[str]) -> ProtocolFile:
    """Return the protocol in `text`, as if it stood in the file `path`; errors as for `read_protocol`."""
    try:
        data = parse_toml(text.decode())
    except ValueError as error:  # of the encoding, the syntax or the limits
        fault = f"it is not TOML: {shorten(str(error))}"
        raise InputError("PROTOCOL_INVALID", fault, file=path) from error
    model = protocol_model(bakes="bakes" in data)
    protocol = checked(model, data, file=path, code="PROTOCOL_INVALID")
    for pointer, fault in _check(protocol):
        raise InputError("PROTOCOL_INVALID", f"{pointer}: {fault}", file=path, pointer=pointer)
    return ProtocolFile(Path(path), text, protocol)


def example(name: str) -> bytes:
    """Return the text of a protocol file: "paper", the paper's experiment, or "demo", for the demo's data."""
    place = demo_folder() / PROTOCOL if name == "demo" else Path(__file__).with_name(f"{name}.toml")
    return place.read_bytes()


def single_protocol(
    model: str | os.PathLike[str],
    scene: str | os.PathLike[str],
    *,
    non_engine: str | None = None,
    image_folder: str | None = None,
) -> ProtocolFile:
    """Return the protocol that evaluates one model on one scene, as if it stood in the current folder.

    Its results are in a folder of their own, named by the model and the scene. `non_engine` is a folder of
    official renderings, or "reference".
    """
    from msb.scenes.datasets import dataset_of

    check_names(Path(scene).absolute(), Path(model).absolute())
    folder = f"{Path(model).absolute().stem}-{Path(scene).absolute().name}-results"
    lines = [
        f"results = {_quoted(folder.replace('{', '{{').replace('}', '}}'))}",
        "",
        "[[datasets]]",
        f"name = {_quoted(dataset_of(scene))}",
        f"path = {_path(scene)}",
        "",
        "[[methods]]",
        f"model = {_path(model)}",
    ]
    if image_folder is not None:
        lines.append(f"image_folder = {_quoted(image_folder)}")
    if non_engine is not None:
        lines.append(f"non_engine = {_quoted(REFERENCE) if non_engine == REFERENCE else _path(non_engine)}")
    return parse_protocol("\n".join(lines).encode() + b"\n", PROTOCOL_NAME)


def _path(given: str | os.PathLike[str]) -> str:
    """Return a path as a protocol has it: the names as given, not where links lead; braces doubled."""
    absolute = os.path.abspath(given_path(given))  # noqa: PTH100 - resolve() follows links
    return _quoted(absolute.replace("{", "{{").replace("}", "}}"))


def _quoted(text: str) -> str:
    """Return `text` as TOML writes it: as JSON, without pairs of surrogates and without a raw DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


# Place and fault of what types alone cannot refuse.
_Faults = Iterator[tuple[str, str]]


def _check(protocol: Protocol) -> _Faults:
    from msb.render.backend import BUILT_IN, renderers

    for number, method in enumerate(protocol.methods):
        yield from _check_method(method, protocol, f"/methods/{number}")
    yield from _check_labels(protocol)
    for number, variant in enumerate(protocol.variants):
        yield from _check_variant(variant, protocol, f"/variants/{number}")
    if protocol.bakes:
        from msb.bake.options import BakeOptions

        for number, bake in enumerate(protocol.bakes):
            yield from _check_datasets(bake, protocol, f"/bakes/{number}")
            yield from _refused(f"/bakes/{number}", partial(BakeOptions, **bake.options))
    walked = () if protocol.walk is None else protocol.walk.conditions
    labels = [*(one.label for one in protocol.variants), *(one.label for one in protocol.bakes)]
    drawn = (*WALKED, *protocol.engines, *labels)
    for name in walked:
        if name not in drawn:
            text = f'nothing called "{shorten(name)}" is drawn; there are {", ".join(drawn)}'
            yield "/walk/conditions", text
    if protocol.trial is not None:
        from msb.trial.registry import chosen_tasks

        yield from _refused("/trial/tasks", chosen_tasks, protocol.trial.tasks)
    engines = [name for name in renderers() if name not in BUILT_IN]
    for engine in protocol.engines:
        if engine not in engines:
            yield "/engines", f'there is no engine "{engine}"; there are {", ".join(engines) or "none"}'


def _check_method(method: MethodTable, protocol: Protocol, place: str) -> _Faults:
    from msb.asset.settings import check_overrides

    if method.name != AUTO and method.name not in METHODS:
        titles = {each.title.lower(): name for name, each in METHODS.items()}
        meant = titles.get(method.name.lower())
        there = ", ".join((AUTO, *METHODS)) + (f"; {method.name} is called {meant} here" if meant else "")
        yield f"{place}/name", f'there is no method "{shorten(method.name)}"; there are {there}'
    if method.model is None and (method.name == AUTO or method.non_engine in (None, REFERENCE)):
        yield place, "it has no model, and no name with a folder of official renderings instead"
    known = PLACES if method.name != AUTO else PLACES[:2]
    there = ", ".join(f"{{{name}}}" for name in known)
    for key in ("model", "non_engine", "non_engine_timing", "training", "mesh"):
        for match in PLACE.finditer(getattr(method, key) or ""):
            if match[1] is not None and match[1] not in known:
                yield f"{place}/{key}", f"there is no {{{shorten(match[1])}}}; there are {there}"
    yield from _check_datasets(method, protocol, place)
    if method.name != AUTO:
        yield from _refused(f"{place}/settings", check_overrides, method.name, overrides(method))


def _check_datasets(table: MethodTable | BakeTable, protocol: Protocol, place: str) -> _Faults:
    there = [dataset.name for dataset in protocol.datasets]
    for name in table.datasets:
        if name not in there:
            yield f"{place}/datasets", f'there is no dataset "{name}"; there are {", ".join(there)}'


def _check_labels(protocol: Protocol) -> _Faults:
    """Find a name of a model, a variant or a bake that would stand for two things in a table or a folder."""
    methods: dict[str, str] = {}
    for number, method in enumerate(protocol.methods):
        place = f"/methods/{number}/label"
        if method.label is None:
            continue
        if method.label in (AUTO, *METHODS):
            yield place, f'"{method.label}" is the name of a method; take another'
        of = methods.setdefault(method.label.casefold(), method.name)
        if of != method.name:
            yield place, f'"{shorten(method.label)}" is the label of {of} already; take another'
    taken = {name.casefold(): "a condition" for name in CONDITIONS}
    taken |= {name.casefold(): "an engine" for name in protocol.engines}
    variants = [(f"/variants/{n}/label", one.label, "a variant") for n, one in enumerate(protocol.variants)]
    bakes = [(f"/bakes/{n}/label", one.label, "a bake") for n, one in enumerate(protocol.bakes)]
    for place, label, what in (*variants, *bakes):
        if label.casefold() in taken:
            yield place, f'"{shorten(label)}" is the name of {taken[label.casefold()]} already; take another'
        taken[label.casefold()] = what


def _check_variant(variant: VariantTable, protocol: Protocol, place: str) -> _Faults:
    from msb.asset.settings import check_overrides
    from msb.render.backend import renderers

    if not (variant.options or variant.renderer or variant.settings):
        yield place, "it is the dedicated tier as it is; give it an order, sampling, renderer or settings"
    if variant.renderer is not None and variant.renderer not in renderers():
        there = ", ".join(renderers())
        text = f'there is no renderer "{shorten(variant.renderer)}"; there are {there}'
        yield f"{place}/renderer", text
    names = [method.name for method in protocol.methods]
    known = METHODS if AUTO in names else names
    for name, value in overrides(variant).items():
        able = [method for method in known if name in METHODS[method].settings]
        for method in able or known:
            yield from _refused(f"{place}/settings", check_overrides, method, {name: value})


def _refused(place: str, check: Callable[..., object], *arguments: Any) -> _Faults:
    try:
        check(*arguments)
    except UsageError as error:
        yield place, error.message


def overrides(table: MethodTable | VariantTable) -> dict[str, Any]:
    """Return the settings of `table`; TOML has no null, so "none" switches one off, as ``--set`` does."""
    return {name: None if value == "none" else value for name, value in table.settings.items()}
