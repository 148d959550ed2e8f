"""The arguments and results of adapters: the content of a file, settings, and the model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.adapters.checkpoint import read_checkpoint
from msb.adapters.checkpoint.reader import STRANGE
from msb.adapters.locate import TORCH_SUFFIXES, Place
from msb.asset import Description
from msb.asset.manifest import Domain, StoredSetting
from msb.asset.settings import check_overrides
from msb.errors import CheckpointError, Finding, UsageError, shorten
from msb.meshes.files import make_suffix_error
from msb.meshes.ply_table import PlyTable, read_ply_names, read_ply_table
from msb.registry import METHODS, SettingSource


@dataclass(frozen=True)
class Options:
    """Arguments of the caller, in addition to the path: settings by name, and the training's config file.

    Without `check_values`, parameters can be NaN. An audit counts the faces with NaN values. Other commands
    remove these faces.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    config: Path | None = None
    check_values: bool = True


@dataclass(frozen=True)
class Content:
    """The content of the file at a `Place`. The content is read when an adapter needs it."""

    place: Place

    @cached_property
    def value(self) -> Any:
        """The value in a torch file, or None for other kinds of files."""
        if self.place.kind != "torch":
            return None
        file = self.place.file
        try:
            return read_checkpoint(file)
        except CheckpointError as error:
            if error.message != STRANGE or file.suffix.lower() in TORCH_SUFFIXES:
                raise
        # neither the name nor the content of the file is known
        raise make_suffix_error(str(file), file.suffix)

    @cached_property
    def ply_names(self) -> tuple[str, ...]:
        """The vertex properties of a PLY without faces; no properties for other files."""
        if self.place.kind != "ply":
            return ()
        names, has_faces = read_ply_names(self.place.file)
        return () if has_faces else names

    def table(self) -> PlyTable:
        """Return the rows of a PLY without faces."""
        return read_ply_table(self.place.file)

    def mapping(self, file: Path) -> Mapping[Any, Any]:
        """Return the dictionary in a file of torch."""
        if not isinstance(self.value, dict):
            text = f"the file contains a {type(self.value).__name__}; a dictionary of tensors is needed"
            raise CheckpointError("CHECKPOINT_LAYOUT", text, file=file)
        return self.value


class Settings:
    """The settings of a model while an adapter collects them.

    Parameters
    ----------
    method : str
        The name of the method in `METHODS`.
    flags : mapping
        The settings of the user. An invalid name or value is a `UsageError`.
    """

    def __init__(self, method: str, flags: Mapping[str, Any]) -> None:
        self._known = METHODS[method].settings
        self._flags = check_overrides(method, flags)
        self._stored: dict[str, StoredSetting] = {}

    def add(
        self, name: str, value: Any, source: SettingSource, file: Path | None = None, key: str | None = None
    ) -> None:
        """Set `name` to `value`, unless the user sets `name`.

        `file` is the file with the stored value, and `key` is the key of the value in this file.
        """
        if name in self._flags:
            return
        if not isinstance(value, bool | int | float | str | None):
            value = f"a {type(value).__name__}"
        if problem := self._known[name].problem(value):
            code = "CHECKPOINT_CONFIG" if source == "config" else "CHECKPOINT_LAYOUT"
            text = f"{key or name} is {shorten(repr(value), 40)}; it {problem}"
            raise CheckpointError(code, text, file=file, pointer=key or name)
        self._stored[name] = StoredSetting(value, source)

    def finish(self, degree: int | None = None) -> dict[str, StoredSetting]:
        """Return all settings in the method's order; `degree` is the stored SH degree."""
        wanted = self._flags.get("sh_degree")
        if isinstance(wanted, int) and degree is not None and wanted > degree:
            text = f"the setting sh_degree is {wanted}; the checkpoint only stores degree {degree}"
            raise UsageError("SETTING_VALUE", text)
        settings = {}
        for name, setting in self._known.items():
            default = setting.default if name != "sh_degree" else degree
            settings[name] = self._stored.get(name, StoredSetting(default, "default"))
            if name in self._flags:
                settings[name] = StoredSetting(self._flags[name], "flag")
        return settings


@dataclass(frozen=True, eq=False)
class Model:
    """A trained model: arrays, their domains, and the description for the manifest.

    Attributes
    ----------
    buffers : dict of str to ndarray
        Arrays with the buffer names of an asset. If the file layout permits, they are views of the mapped
        file.
    domains : dict of str to {"vertex", "face", "corner", "global"}
        The domain of every buffer except `positions` and `indices`.
    description : Description
        Method, kernels and settings. `export` sets the `source` of the description.
    root : Path
        The output folder of the training, or the folder of the single file.
    files : tuple of Path
        All files that were read, beginning with the file of the model.
    warnings : tuple of Finding
        Missing or unusual values, and their replacements.
    opened_from : Path or None
        `Place.given`, the path from the user. `read_model` sets it.
    """

    buffers: dict[str, NDArray[Any]]
    domains: dict[str, Domain]
    description: Description
    root: Path
    files: tuple[Path, ...]
    warnings: tuple[Finding, ...] = ()
    opened_from: Path | None = None


def soup_buffers(
    triangles: NDArray[np.float32], **by_face: NDArray[np.float32] | None
) -> dict[str, NDArray[Any]]:
    """Return buffers of separate triangles (N, 3, 3) with values `by_face` (N, ...). A value of None adds no
    buffer."""
    count = len(triangles)
    buffers: dict[str, NDArray[Any]] = {
        "positions": triangles.reshape(3 * count, 3),
        "indices": np.arange(3 * count, dtype=np.uint32).reshape(count, 3),
    }
    for name, values in by_face.items():
        if values is not None:
            buffers[name] = values.reshape(count if values.size == count else (count, -1))
    return buffers


def domains_of(buffers: Mapping[str, NDArray[Any]], domain: Domain) -> dict[str, Domain]:
    """Return a mapping with one domain for all buffers, except positions and indices, whose domains are
    fixed."""
    return dict.fromkeys(buffers.keys() - {"positions", "indices"}, domain)


def sh_appearance(degree: int, white: object = None) -> dict[str, Any]:
    """Return the section `appearance` of SH colours. The section has a background if `white` is a bool."""
    appearance: dict[str, Any] = {"kind": "spherical_harmonics"}
    if degree:
        appearance["f_rest_order"] = "coefficient_major"
    return {**appearance, **background_of(white)}


def background_of(white: object) -> dict[str, str]:
    """Return the entry `background` (white or black) for the section `appearance` of a manifest.

    If `white` is not a bool, the result is empty.
    """
    return {"background": "#ffffff" if white else "#000000"} if isinstance(white, bool) else {}
