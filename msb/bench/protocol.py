"""Read and validate protocol files (TOML), which name the methods, scenes and conditions of a benchmark."""

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
    make_protocol_model,
)
from msb.bench.records import CONDITIONS, WALKED
from msb.bench.validation import read_bytes, validate
from msb.errors import InputError, UsageError, shorten
from msb.registry import METHODS

PROTOCOL_NAME = "protocol.toml"
# Maximum size of a protocol in bytes.
_MAX_BYTES = 1 << 20


@dataclass(frozen=True)
class ProtocolFile:
    """A protocol and its file. Paths in the protocol are relative to the folder of the file."""

    path: Path
    # The text of the protocol file, which is copied to the results.
    text: bytes
    protocol: Protocol
    # Folder that replaces the protocol's results folder, if it is given.
    results_instead: Path | None = None

    @property
    def results(self) -> Path:
        """The results folder."""
        if self.results_instead is not None:
            return self.results_instead.absolute()
        return self.resolve(self.protocol.results)

    @property
    def vgg_weights(self) -> Path | None:
        """The file of the weights of LPIPS. With "auto" in the protocol, the file in the cache of torch."""
        text = self.protocol.metrics.vgg_weights
        if text != "auto":
            return None if text is None else self.resolve(text)
        from msb.metrics.vgg import find_vgg

        return find_vgg()

    def resolve(self, template: str, **names: str) -> Path:
        """Return the absolute path of a template, with placeholders such as {scene} filled from `names`."""

        def fill(match: re.Match[str]) -> str:
            return match[0][0] if match[1] is None else names.get(match[1], match[0])

        filled = PLACE.sub(fill, template)
        return Path(os.path.normpath(Path(self.path.absolute().parent, Path(filled).expanduser())))


def read_protocol(path: str | os.PathLike[str]) -> ProtocolFile:
    """Return the protocol in the TOML file `path`."""
    return parse_protocol(read_bytes(path, _MAX_BYTES, "PROTOCOL_INVALID"), path)


def parse_protocol(text: bytes, path: str | os.PathLike[str]) -> ProtocolFile:
    """Return the protocol in `text`. Relative paths and errors refer to the file `path`."""
    try:
        data = parse_toml(text.decode())
    except ValueError as error:  # invalid encoding or syntax, or a number or nesting beyond the limits
        fault = f"the file is not valid TOML: {shorten(str(error))}"
        raise InputError("PROTOCOL_INVALID", fault, file=path) from error
    model = make_protocol_model(bakes="bakes" in data)
    protocol = validate(model, data, file=path, code="PROTOCOL_INVALID")
    for pointer, fault in _find_faults(protocol):
        raise InputError("PROTOCOL_INVALID", f"{pointer}: {fault}", file=path, pointer=pointer)
    return ProtocolFile(Path(path), text, protocol)


def read_example(name: str) -> bytes:
    """Return the content of an example: "paper" (the paper's experiment) or "demo" (for msb demo-data)."""
    place = demo_folder() / PROTOCOL if name == "demo" else Path(__file__).with_name(f"{name}.toml")
    return place.read_bytes()


def make_single_protocol(
    model: str | os.PathLike[str],
    scene: str | os.PathLike[str],
    *,
    non_engine: str | None = None,
    dataset: str | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    camera_convention: str | None = None,
) -> ProtocolFile:
    """Return a protocol that evaluates one model on one scene, as if its file were in the current folder.

    The results folder has the name of the model and the scene. `non_engine` is a folder of official
    renderings, or "reference" for our reference renderer. The other options are the options of `read_scene`.
    """
    from msb.scenes.datasets import dataset_of

    check_names(Path(scene).absolute(), Path(model).absolute())
    folder = f"{Path(model).absolute().stem}-{Path(scene).absolute().name}-results"
    lines = [
        f"results = {_quote(folder.replace('{', '{{').replace('}', '}}'))}",
        "",
        "[[datasets]]",
        f"name = {_quote(dataset or dataset_of(scene))}",
        f"path = {_format_path(scene)}",
        "",
        "[[methods]]",
        f"model = {_format_path(model)}",
    ]
    for key, text in (("image_folder", image_folder), ("camera_convention", camera_convention)):
        if text is not None:
            lines.append(f"{key} = {_quote(text)}")
    if resolution is not None:
        lines.append(f"resolution = {resolution}")
    if non_engine is not None:
        lines.append(
            f"non_engine = {_quote(REFERENCE) if non_engine == REFERENCE else _format_path(non_engine)}"
        )
    return parse_protocol("\n".join(lines).encode() + b"\n", PROTOCOL_NAME)


def _format_path(given: str | os.PathLike[str]) -> str:
    """Return the absolute path as a TOML string with doubled braces. Symbolic links are not resolved."""
    absolute = os.path.abspath(given_path(given))  # noqa: PTH100 - resolve() follows links
    return _quote(absolute.replace("{", "{{").replace("}", "}}"))


def _quote(text: str) -> str:
    """Return `text` as a TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


# Yield pairs (JSON pointer, text) for errors that the types of the tables cannot detect.
_Faults = Iterator[tuple[str, str]]


def _find_faults(protocol: Protocol) -> _Faults:
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
            yield from _check_call(f"/bakes/{number}", partial(BakeOptions, **bake.options))
    # A walk (camera path) may name only conditions that our renderers or an engine can render.
    walked = () if protocol.walk is None else protocol.walk.conditions
    labels = [*(table.label for table in protocol.variants), *(table.label for table in protocol.bakes)]
    rendered = (*WALKED, *protocol.engines, *labels)
    for name in walked:
        if name not in rendered:
            text = f'unknown condition "{shorten(name)}"; conditions with a walk are {", ".join(rendered)}'
            yield "/walk/conditions", text
    if protocol.trial is not None:
        from msb.trial.registry import select_tasks

        yield from _check_call("/trial/tasks", select_tasks, protocol.trial.tasks)
    engines = [name for name in renderers() if name not in BUILT_IN]
    for engine in protocol.engines:
        if engine not in engines:
            yield "/engines", f'unknown engine "{engine}"; available: {", ".join(engines) or "none"}'


def _check_method(method: MethodTable, protocol: Protocol, place: str) -> _Faults:
    from msb.asset.settings import check_overrides

    if method.name != AUTO and method.name not in METHODS:
        titles = {known.title.lower(): name for name, known in METHODS.items()}
        meant = titles.get(method.name.lower())
        hint = f"did you mean {meant}?" if meant else f"known methods: {', '.join((AUTO, *METHODS))}"
        yield f"{place}/name", f'unknown method "{shorten(method.name)}"; {hint}'
    if method.model is None and (method.name == AUTO or method.non_engine in (None, REFERENCE)):
        yield place, "a method needs a model, or a name and a folder of official renderings (non_engine)"
    # The path of a model must not contain {method} if the method is detected from the model.
    placeholders = PLACES if method.name != AUTO else PLACES[:2]
    listed = ", ".join(f"{{{name}}}" for name in placeholders)
    for key in ("model", "non_engine", "non_engine_timing", "training", "mesh"):
        for match in PLACE.finditer(getattr(method, key) or ""):
            if match[1] is not None and match[1] not in placeholders:
                text = f"unknown placeholder {{{shorten(match[1])}}}; available: {listed}"
                yield f"{place}/{key}", text
    yield from _check_datasets(method, protocol, place)
    if method.name != AUTO:
        yield from _check_call(f"{place}/settings", check_overrides, method.name, get_overrides(method))


def _check_datasets(table: MethodTable | BakeTable, protocol: Protocol, place: str) -> _Faults:
    names = [dataset.name for dataset in protocol.datasets]
    for name in table.datasets:
        if name not in names:
            text = f'"{name}" is not a dataset of this protocol, which has {", ".join(names)}'
            yield f"{place}/datasets", text


def _check_labels(protocol: Protocol) -> _Faults:
    """Yield an error for each label that is already used as a column or folder name."""
    # For each label of a model, the method of the model. Two models of a method may share a label if their
    # scenes differ.
    methods: dict[str, str] = {}
    for number, method in enumerate(protocol.methods):
        place = f"/methods/{number}/label"
        if method.label is None:
            continue
        if method.label in (AUTO, *METHODS):
            yield place, f'"{method.label}" is the name of a method; use another label'
        other = methods.setdefault(method.label.casefold(), method.name)
        if other != method.name:
            yield place, f'"{shorten(method.label)}" is already the label of {other}; use another label'
    # The names of conditions, engines, variants and bakes are also names of folders and columns.
    taken = {name.casefold(): "a condition" for name in CONDITIONS}
    taken |= {name.casefold(): "an engine" for name in protocol.engines}
    variants = [
        (f"/variants/{n}/label", table.label, "a variant") for n, table in enumerate(protocol.variants)
    ]
    bakes = [(f"/bakes/{n}/label", table.label, "a bake") for n, table in enumerate(protocol.bakes)]
    for place, label, kind in (*variants, *bakes):
        if label.casefold() in taken:
            other = taken[label.casefold()]
            yield place, f'"{shorten(label)}" is already the name of {other}; use another label'
        taken[label.casefold()] = kind


def _check_variant(variant: VariantTable, protocol: Protocol, place: str) -> _Faults:
    from msb.asset.settings import check_overrides
    from msb.render.backend import renderers

    if not (variant.options or variant.renderer or variant.settings):
        yield place, "a variant must set at least one of order, sampling, renderer and settings"
    if variant.renderer is not None and variant.renderer not in renderers():
        text = f'unknown renderer "{shorten(variant.renderer)}"; available: {", ".join(renderers())}'
        yield f"{place}/renderer", text
    # A setting is checked for every method that has this setting. An unknown setting is an error.
    names = [method.name for method in protocol.methods]
    known = METHODS if AUTO in names else names
    for name, value in get_overrides(variant).items():
        able = [method for method in known if name in METHODS[method].settings]
        for method in able or known:
            yield from _check_call(f"{place}/settings", check_overrides, method, {name: value})


def _check_call(place: str, check: Callable[..., object], *arguments: Any) -> _Faults:
    """Call a function. If the function raises a UsageError, yield an error at `place`."""
    try:
        check(*arguments)
    except UsageError as error:
        yield place, error.message


def get_overrides(table: MethodTable | VariantTable) -> dict[str, Any]:
    """Return the settings of a table. The text "none" becomes None, because TOML has no null."""
    return {name: None if value == "none" else value for name, value in table.settings.items()}
