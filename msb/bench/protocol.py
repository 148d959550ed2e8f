"""The protocol file (TOML): which methods are evaluated on which scenes, in which conditions, and how."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from msb.bench.checked import checked, read_bytes
from msb.bench.folder import check_names
from msb.bench.profile import TIMED_FRAMES, TIMED_SECONDS
from msb.bench.records import CONDITIONS, Condition
from msb.bounded_parsing import parse_toml
from msb.errors import InputError, MsbError, UsageError, shorten
from msb.methods import METHODS, Order, Sampling
from msb.paths import given_path

AUTO = "auto"
PROTOCOL_NAME = "protocol.toml"
REFERENCE = "reference"
"""The word that stands for our NumPy renderer in the place of a folder of official renderings."""
_MAX_BYTES = 1 << 20
_PLACES = ("dataset", "scene", "method")
_PLACE = re.compile(r"\{\{|\}\}|\{(.*?)\}")
"""A placeholder in a path; doubled braces stand for single ones."""
_NAME = r"^[^/\\\x00-\x1f.][^/\\\x00-\x1f]*$"
"""A name that becomes the name of a folder below the results."""

FolderName = Annotated[str, Field(pattern=_NAME, max_length=100)]
Template = Annotated[str, Field(min_length=1)]
"""A path relative to the protocol file, in which {dataset}, {scene} and {method} are placeholders."""
Unit = Annotated[float, Field(ge=0, le=1)]
Color = tuple[Unit, Unit, Unit]
Setting = bool | int | float | str


class _Table(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, protected_namespaces=()
    )


class SceneOptions(_Table):
    """Options of a scene, set by its dataset; where a method sets one too, the method counts.

    Attributes
    ----------
    image_folder : str, optional
        The folder below the scene, such as "images_4"; the dataset's folder if not given.
    resolution : int, optional
        The resolution, with the meaning of ``-r`` in the 3DGS family.
    background : (3,) floats in [0, 1], optional
    camera_convention : {"gs_fov", "full_K"}, optional
        The camera that the method was trained with; by default "full_K" for DiffSoup, "gs_fov" for all
        others.
    """

    image_folder: Annotated[str, Field(min_length=1)] | None = None
    resolution: int | None = None
    background: Color | None = None
    camera_convention: Literal["gs_fov", "full_K"] | None = None


class DatasetTable(SceneOptions):
    """``[[datasets]]``: scenes of one dataset in one folder.

    Attributes
    ----------
    name : str
        "mipnerf360", "tanksandtemples", "nerf_synthetic", "dtu", or any other for a capture of your own.
    path : str
        The folder that holds the scenes' folders.
    scenes : tuple of str
        The names of the scenes; all scenes in the folder, if not given.
    """

    name: FolderName
    path: Annotated[str, Field(min_length=1)]
    scenes: tuple[FolderName, ...] = ()


class MethodTable(SceneOptions):
    """``[[methods]]``: where one method's models are, and what belongs to them.

    Attributes
    ----------
    name : str
        A name that `msb methods` lists, or "auto", which takes the method found from the model.
    label : str, optional
        Names the model's columns and folders, and tells it from others of its method. It may be no method's
        name.
    model : str, optional
        The template of the checkpoint, .triasset or mesh of each scene. Without it there are official
        renderings only.
    datasets : tuple of str
        The names of the datasets that the method is evaluated on; all, if not given.
    settings : mapping
        Values that replace settings, as ``--set`` takes them.
    conditions : tuple of Condition, optional
        The conditions; those of the protocol, if not given.
    non_engine : str, optional
        The template of the folder of official renderings, or "reference". Without it there is no such cell.
    training : str, optional
        The template of the file that `msb track` wrote.
    mesh : str, optional
        The template of the mesh whose Chamfer distance is measured; the asset's own triangles if not given.
    """

    name: str = AUTO
    label: FolderName | None = None
    model: Template | None = None
    datasets: tuple[FolderName, ...] = ()
    settings: dict[str, Setting] = {}
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] | None = None
    non_engine: Template | None = None
    training: Template | None = None
    mesh: Template | None = None


class VariantTable(_Table):
    """``[[variants]]``: a condition of its own, drawn on the dedicated tier in another way than officially.

    Attributes
    ----------
    label : str
        Names the condition. It may be no condition's, no engine's and no other variant's name.
    order, sampling : str, optional
        As ``--order`` and ``--sampling`` of `msb render` take them; official if not given.
    renderer : str, optional
        A renderer that draws the dedicated tier, by its name in `msb devices`; ours if not given.
    settings : mapping
        Overrides, as ``--set`` takes them, on top of the method's.
    """

    label: FolderName
    order: Order | None = None
    sampling: Sampling | None = None
    renderer: Annotated[str, Field(min_length=1)] | None = None
    settings: dict[str, Setting] = {}

    @property
    def options(self) -> dict[str, str]:
        """What of `order` and `sampling` is given, as a renderer takes it."""
        given = {"order": self.order, "sampling": self.sampling}
        return {name: value for name, value in given.items() if value is not None}


class MetricsTable(_Table):
    """``[metrics]``: `vgg_weights` is the file of torchvision's VGG16, without which LPIPS is "--"."""

    vgg_weights: str | None = None


class TimingTable(_Table):
    """``[timing]``: the clock runs for at least `frames` and `seconds`; 0 frames mean no timing."""

    frames: Annotated[int, Field(ge=0)] = TIMED_FRAMES
    seconds: Annotated[float, Field(ge=0)] = TIMED_SECONDS


class ChamferTable(_Table):
    """``[chamfer]``, for scenes of DTU: the official evaluation data, and the seed of the sampling."""

    data: Annotated[str, Field(min_length=1)]
    seed: Annotated[int, Field(ge=0)] = 0


class VideosTable(_Table):
    """``[videos]``: films that show conditions side by side along a path.

    The `path` "flight" goes smoothly through the test cameras; "test" shows the test views themselves, and
    beside them the photographs and the official renderings.
    """

    path: Literal["flight", "test"] = "flight"
    frames: Annotated[int, Field(ge=2, le=100_000)] = 120
    fps: Annotated[int, Field(ge=1, le=240)] = 24


class Protocol(_Table):
    """The whole file. docs/protocol.md has it with comments."""

    results: Annotated[str, Field(min_length=1)] = "results"
    device: str | None = None
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] = CONDITIONS
    engines: tuple[FolderName, ...] = ()
    datasets: Annotated[tuple[DatasetTable, ...], Field(min_length=1)]
    methods: Annotated[tuple[MethodTable, ...], Field(min_length=1)]
    variants: tuple[VariantTable, ...] = ()
    metrics: MetricsTable = MetricsTable()
    timing: TimingTable = TimingTable()
    chamfer: ChamferTable | None = None
    videos: VideosTable | None = None


@dataclass(frozen=True)
class ProtocolFile:
    """A protocol and the file it came from. Paths in it are relative to that file's folder.

    Attributes
    ----------
    path : Path
    text : bytes
        The content of the file, which is kept with the results.
    protocol : Protocol
    results_instead : Path, optional
        The results folder to use instead of the one that the file names.
    """

    path: Path
    text: bytes
    protocol: Protocol
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

        filled = _PLACE.sub(fill, template)
        return Path(os.path.normpath(Path(self.path.absolute().parent, Path(filled).expanduser())))


def read_protocol(path: str | os.PathLike[str]) -> ProtocolFile:
    """Return the protocol in the TOML file `path`.

    Raises
    ------
    InputError
        FILE_NOT_FOUND, FILE_UNREADABLE or PROTOCOL_INVALID, naming the key or the line.
    """
    return parse_protocol(read_bytes(path, _MAX_BYTES, "PROTOCOL_INVALID"), path)


def parse_protocol(text: bytes, path: str | os.PathLike[str]) -> ProtocolFile:
    """Return the protocol in `text`, as if it stood in the file `path`; errors as for `read_protocol`."""
    try:
        data = parse_toml(text.decode())
    except ValueError as error:  # of the encoding, the syntax or the limits
        raise _bad(path, f"it is not TOML: {shorten(str(error))}") from error
    protocol = checked(Protocol, data, file=path, code="PROTOCOL_INVALID")
    _check(protocol, path)
    return ProtocolFile(Path(path), text, protocol)


def single_protocol(
    model: str | os.PathLike[str], scene: str | os.PathLike[str], *, non_engine: str | None = None
) -> ProtocolFile:
    """Return the protocol that evaluates one model on one scene, as if it stood in the current folder.

    Parameters
    ----------
    model, scene : path-like
        A checkpoint, .triasset or mesh; the scene's folder.
    non_engine : str, optional
        A folder of official renderings, or "reference".

    Raises
    ------
    InputError, SceneError
        `scene` is no scene.
    UsageError
        RUN_PATH_NAME.
    """
    from msb.scenes.datasets import read_scene

    check_names(Path(scene).absolute(), Path(model).absolute())
    lines = [
        "[[datasets]]",
        f"name = {_quoted(read_scene(scene).dataset)}",
        f"path = {_path(scene)}",
        "",
        "[[methods]]",
        f"model = {_path(model)}",
    ]
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


def _check(protocol: Protocol, path: object) -> None:
    """Refuse what types alone cannot."""
    for number, method in enumerate(protocol.methods):
        where = f"/methods/{number}"
        if method.name != AUTO and method.name not in METHODS:
            there = ", ".join((AUTO, *METHODS))
            text = f'{where}/name: there is no method "{shorten(method.name)}"; there are {there}'
            raise _bad(path, text, f"{where}/name")
        if method.model is None and (method.name == AUTO or method.non_engine in (None, REFERENCE)):
            text = f"{where}: it has no model, and no name with a folder of official renderings instead"
            raise _bad(path, text, where)
        for key in ("model", "non_engine", "training", "mesh"):
            known = _PLACES if method.name != AUTO else _PLACES[:2]
            for found in _PLACE.finditer(getattr(method, key) or ""):
                if found[1] is not None and found[1] not in known:
                    there = ", ".join(f"{{{name}}}" for name in known)
                    text = f"{where}/{key}: there is no {{{shorten(found[1])}}}; there are {there}"
                    raise _bad(path, text, f"{where}/{key}")
        there_are = [dataset.name for dataset in protocol.datasets]
        for name in method.datasets:
            if name not in there_are:
                text = f'{where}/datasets: there is no dataset "{name}"; there are {", ".join(there_are)}'
                raise _bad(path, text, f"{where}/datasets")
        if method.name != AUTO:
            _check_settings(method, where, path)
    _check_labels(protocol, path)
    from msb.render.backend import BUILT_IN, renderers

    engines = [name for name in renderers() if name not in BUILT_IN]
    for engine in protocol.engines:
        if engine not in engines:
            text = f'/engines: there is no engine "{engine}"; there are {", ".join(engines) or "none"}'
            raise _bad(path, text, "/engines")


def _check_labels(protocol: Protocol, path: object) -> None:
    """Refuse a name of a model or a variant that would stand for two things in a table or a folder."""
    methods: dict[str, str] = {}
    for number, method in enumerate(protocol.methods):
        if method.label is None:
            continue
        where = f"/methods/{number}/label"
        if method.label in (AUTO, *METHODS):
            text = f'{where}: "{method.label}" is the name of a method; take another'
            raise _bad(path, text, where)
        of = methods.setdefault(method.label.casefold(), method.name)
        if of != method.name:
            text = f'{where}: "{shorten(method.label)}" is the label of {of} already; take another'
            raise _bad(path, text, where)
    taken = {name.casefold(): "a condition" for name in CONDITIONS}
    taken |= {name.casefold(): "an engine" for name in protocol.engines}
    for number, variant in enumerate(protocol.variants):
        where = f"/variants/{number}"
        if of_what := taken.get(variant.label.casefold()):
            text = f'{where}/label: "{shorten(variant.label)}" is the name of {of_what} already; take another'
            raise _bad(path, text, f"{where}/label")
        taken[variant.label.casefold()] = "a variant"
        _check_variant(variant, protocol, where, path)


def _check_variant(variant: VariantTable, protocol: Protocol, where: str, path: object) -> None:
    from msb.asset.settings import check_overrides
    from msb.render.backend import renderers

    if not (variant.options or variant.renderer or variant.settings):
        text = f"{where}: it is the dedicated tier as it is; give it an order, sampling, renderer or settings"
        raise _bad(path, text, where)
    if variant.renderer is not None and variant.renderer not in renderers():
        text = f'{where}/renderer: there is no renderer "{shorten(variant.renderer)}"'
        raise _bad(path, f"{text}; there are {', '.join(renderers())}", f"{where}/renderer")
    names = [method.name for method in protocol.methods]
    known = METHODS if AUTO in names else names
    for name, value in overrides(variant).items():
        able = [method for method in known if name in METHODS[method].settings]
        try:
            for method in able or known:
                check_overrides(method, {name: value})
        except UsageError as error:
            raise _bad(path, f"{where}/settings: {error.message}", f"{where}/settings") from None


def _check_settings(method: MethodTable, where: str, path: object) -> None:
    from msb.asset.settings import check_overrides

    try:
        check_overrides(method.name, overrides(method))
    except UsageError as error:
        raise _bad(path, f"{where}/settings: {error.message}", f"{where}/settings") from None


def overrides(table: MethodTable | VariantTable) -> dict[str, Any]:
    """Return the settings of `table`; TOML has no null, so "none" switches one off, as ``--set`` does."""
    return {name: None if value == "none" else value for name, value in table.settings.items()}


def _bad(path: object, text: str, pointer: str | None = None) -> MsbError:
    return InputError("PROTOCOL_INVALID", text, file=path, pointer=pointer)
