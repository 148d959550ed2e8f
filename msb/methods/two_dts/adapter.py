"""Read 2DTS: ``ckpt/N.ckpt`` or ``point_cloud/N.ply``, and the training's configuration file.

Layout: GaodeRender/triangle-splatting at 54c80f7 (src/diff_recon: the model's state dict and PLY writer). A
primitive is a separate triangle with one opacity logit and one set of SH coefficients; `gamma` is global.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from numpy.typing import NDArray

from msb.adapters.locate import Place
from msb.adapters.model import Content, Model, Options, Settings, domains_of, sh_appearance, soup_buffers
from msb.adapters.tensors import Tensors
from msb.adapters.training_config import missing, named_up, read_text, unusable
from msb.asset import Description
from msb.asset.manifest import CoordinateFrame
from msb.errors import CheckpointError, Finding, finding, json_safe, shorten
from msb.meshes.ply_table import PlyTable

KEYS = ("_vertex", "_opacity", "_f_dc", "_f_rest")
_CORNERS = tuple(f"{axis}{corner}" for corner in (1, 2, 3) for axis in "xyz")
_PLY_NAMES = (*_CORNERS, "opacity", "f_dc_0", "f_dc_1", "f_dc_2")
# The key of each setting in the configuration section "model", and the official default.
_UPSTREAM: dict[str, tuple[str, Any]] = {
    "rasterizer": ("rasterizer_type", "3D"),
    "sh_degree": ("max_sh_degree", None),
    "back_culling": ("back_culling", False),
    "gamma_rescale": ("gamma_rescale", False),
    "ste_threshold": ("ste_threshold", None),
    "render_up_scale": ("render_up_scale", None),
}

# Maximum accepted nesting of a configuration; real configurations have 3 levels.
MAX_DEPTH = 32
# The first entry of the log is a YAML dump between two lines of "=" (GaodeRender/triangle-splatting).
_LOG_HEAD = re.compile(r"config args:[ \t]*\n=+[^\n]*=+[ \t]*\n(.*?)^=+[ \t]*$", re.DOTALL | re.MULTILINE)


def training_scene(root: Path) -> object:
    """Return the folder of the training scene that the configuration in `root` names, or None."""
    dataset = read_config(root, None)[0].get("dataset")
    return dataset.get("local_dir") if isinstance(dataset, dict) else None


def recognises(content: Content) -> bool:
    """Return whether `content` is a checkpoint tuple with the keys of 2DTS, or a PLY of triangles."""
    if content.ply_names:
        return "x1" in content.ply_names and "z3" in content.ply_names
    value = content.value
    return (
        isinstance(value, tuple)
        and bool(value)
        and isinstance(value[0], dict)
        and not value[0].keys().isdisjoint(KEYS)
    )


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the model at `place`."""
    settings = Settings("two_dts", options.settings)
    box: list[float] | None = None
    warnings: list[Finding] = []
    if place.kind == "ply":
        tensors, prefix = _table_tensors(content.table(), place.file, options.check_values), ""
        text = "a PLY does not store gamma: 1 is used, as in the official loader; set it with --set gamma=G"
        warnings.append(finding("CHECKPOINT_CONFIG_MISSING", text, severity="warning", file=str(place.file)))
    else:
        tensors, gamma, box = _parts(content.value, place.file, options.check_values)
        prefix = "_"
        settings.add("gamma", gamma, "checkpoint", place.file, "gamma")
    buffers, degree = _buffers(tensors, prefix)
    warnings += tensors.warnings
    # Settings come from the configuration, otherwise from the official defaults.
    config, files, config_warnings = read_config(place.root, options.config)
    warnings += config_warnings
    if config:
        warnings += _configure(settings, config["model"], degree, files[0])
    else:
        settings.add("sh_degree", degree, "checkpoint")
    stored = settings.finish(degree)
    trainer = config.get("trainer")
    trainer = trainer if isinstance(trainer, dict) else {}
    white = {"white": True, "black": False}.get(str(trainer.get("eval_background")))
    up = named_up(trainer.get("output_dir"))  # outputs/MipNerf360/VanillaTS
    bounds = dict(zip(_box_names(box), box or (), strict=True))
    description = Description(
        method="two_dts",
        sh_degree=degree,
        coverage={"kernel": "gaussian_power", "gamma": stored["gamma"].value},
        opacity={"encoding": "logit"},
        appearance=sh_appearance(degree, white),
        compositing={"kind": "front_to_back", **bounds},
        settings=stored,
        coordinate_frame=CoordinateFrame(up=up),
    )
    domains, files = domains_of(buffers, "face"), (place.file, *files)
    return Model(buffers, domains, description, place.root, files, tuple(warnings))


def _box_names(box: list[float] | None) -> tuple[str, ...]:
    """Return the manifest keys of the scene box, for a box of 4 or 6 numbers."""
    axes = "xyz"[: len(box) // 2] if box else ""
    return tuple(f"scene_bbox_{end}_{axis}" for end in ("min", "max") for axis in axes)


def _parts(value: Any, file: Path, check_values: bool) -> tuple[Tensors, float, list[float] | None]:
    """Return parameters, gamma and scene box of a checkpoint (params, optimizer, scene_bbox, gamma)."""
    if not isinstance(value, tuple) or len(value) != 4 or not isinstance(value[0], dict):
        what = f"a tuple of {len(value)} items" if isinstance(value, tuple) else "not a tuple"
        text = f"the checkpoint is {what}; it must be (params, optimizer, scene_bbox, gamma)"
        raise CheckpointError("CHECKPOINT_LAYOUT", text, file=file)
    gamma = Tensors({"gamma": value[3]}, file).number("gamma")
    box = value[2]
    if box is not None:
        numbers = isinstance(box, list | tuple) and all(type(item) in (int, float) for item in box)
        if not numbers or len(box) not in (4, 6) or not all(abs(item) < 1e300 for item in box):
            text = "scene_bbox must be None or 4 or 6 finite numbers"
            raise CheckpointError("CHECKPOINT_LAYOUT", text, file=file, pointer="scene_bbox")
        box = [float(item) for item in box]
    return Tensors(value[0], file, check_values), gamma, box


def _table_tensors(table: PlyTable, file: Path, check_values: bool) -> Tensors:
    """Return the columns of a PLY (one row per triangle) in the shapes of a checkpoint.

    `f_rest` is stored coefficient by coefficient, unlike in 3DGS.
    """
    missing = [name for name in _PLY_NAMES if name not in table.names]
    if missing:
        text = f'property "{missing[0]}" of element vertex is missing; a 2DTS PLY has {", ".join(_PLY_NAMES)}'
        raise CheckpointError("CHECKPOINT_LAYOUT", text, file=file, pointer=missing[0])
    width = sum(name.startswith("f_rest_") for name in table.names)
    rest = [f"f_rest_{i}" for i in range(width)]
    if set(rest) - set(table.names) or width % 3:
        text = f"the PLY has {width} properties f_rest_*; SH degrees 0 to 3 need 0, 9, 24 or 45"
        raise CheckpointError("CHECKPOINT_LAYOUT", text, file=file, pointer="f_rest")
    columns: dict[str, tuple[Sequence[str], tuple[int, ...]]] = {
        "vertex": (_CORNERS, (3, 3)),
        "opacity": (("opacity",), (1,)),
        "f_dc": (_PLY_NAMES[-3:], (1, 3)),
        "f_rest": (rest, (width // 3, 3)),
    }
    values = {key: table.columns(c).reshape(table.count, *shape) for key, (c, shape) in columns.items()}
    return Tensors(values, file, check_values)


def _buffers(tensors: Tensors, prefix: str) -> tuple[dict[str, NDArray[Any]], int]:
    """Return the buffers and the SH degree. `prefix` is "_" for a checkpoint and empty for a PLY."""
    vertices = tensors.floats(f"{prefix}vertex", "N", 3, 3)
    opacity = tensors.floats(f"{prefix}opacity", "N", 1, infinite=True)
    f_dc = tensors.floats(f"{prefix}f_dc", "N", 1, 3)
    rest = f"{prefix}f_rest"
    degree = tensors.degree(rest, tensors.axis(rest, 1))
    f_rest = tensors.floats(rest, "N", "K", 3) if degree else None
    return soup_buffers(vertices, opacity=opacity, f_dc=f_dc, f_rest=f_rest), degree


def _configure(settings: Settings, model: dict[str, Any], degree: int, file: Path) -> list[Finding]:
    """Add the settings from section "model" of a configuration, or official defaults; return warnings."""
    warnings = []
    for name, (key, absent) in _UPSTREAM.items():
        value = model.get(key, absent)
        if name == "sh_degree" and key not in model:
            settings.add(name, degree, "checkpoint")
            continue
        if name == "sh_degree" and isinstance(value, int) and value > degree:
            text = shorten(f"model.{key} is {json_safe(value)}; the checkpoint only has degree {degree}", 200)
            warnings.append(finding("CHECKPOINT_CONFIG", text, severity="warning", file=str(file)))
            value = degree
        if name == "ste_threshold" and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        settings.add(name, value, "config" if key in model else "default", file, f"model.{key}")
    return warnings


class _PlainLoader(yaml.SafeLoader):
    """A YAML loader that rejects aliases. Aliases can make a small file expand exponentially, and training
    configurations have none.

    Long integers and deep nesting are also rejected, because the YAML library is recursive.
    """

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent) or self._depth == MAX_DEPTH:
            raise yaml.YAMLError
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        value = super().construct_object(node, deep)
        if isinstance(value, int) and value.bit_length() > 63:
            raise OverflowError
        return value


def read_config(root: Path, given: Path | None) -> tuple[dict[str, Any], tuple[Path, ...], list[Finding]]:
    """Return the configuration of a 2DTS training, the files read, and warnings.

    The first existing file is used, in this order: `given`, a YAML file in the output folder `root`, the
    latest text log in ``root/log``. The result is a nested dictionary such as ``{"model": {...}, "trainer":
    {...}}``.
    """
    if given is not None:
        return _config_of(given), (given,), []
    ignored: list[Finding] = []
    logs = sorted((root / "log").glob("*_outputs.log"), reverse=True) or sorted((root / "log").glob("*.log"))
    for path in (*sorted(root.glob("*.y*ml")), *logs):
        try:
            return _config_of(path), (path,), ignored
        except CheckpointError as error:
            text = f"{path.relative_to(root)}: {error.message}; the file is ignored"
            ignored.append(finding(error.code, text, severity="warning", pointer=path.name))
    text = "no YAML configuration or log found, so the rasterizer and other settings are defaults"
    return {}, (), [*ignored, missing(root, text)]


def _config_of(path: Path) -> dict[str, Any]:
    """Return the configuration in a YAML file or a text log."""
    text = read_text(path)
    if path.suffix == ".log":
        match = _LOG_HEAD.search(text)
        if match is None:
            raise unusable(path, 'the entry "config args:" is missing')
        text = match[1]
    try:
        data = yaml.load(text, _PlainLoader)  # this loader is a SafeLoader, which reads plain values only
    except ArithmeticError:
        raise unusable(path, "a number in the file is too large") from None
    # Invalid values with a YAML tag raise Python errors, such as KeyError for "!!bool maybe".
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" in line {mark.line + 1}"
        raise unusable(path, f"the file is not valid YAML{where}") from None
    if not isinstance(data, dict) or not isinstance(data.get("model"), dict):
        raise unusable(path, 'the section "model" is missing')
    return data
