"""Result records: what one cell of a benchmark (dataset, scene, method, condition) measured, as a JSON file.

`msb run` writes records, and `msb report` reads nothing else. Values are full doubles in SI units, bytes and
milliseconds; a value that could not be had is None, with a reason beside it. docs/protocol.md describes the
file.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from msb.base.version import __version__
from msb.bench.checked import Amount, Count, Name, Record, Sha256, checked, read_json
from msb.bench.documents import (
    AuditDocument,
    BakeDocument,
    ChamferDocument,
    RepairDocument,
    Share,
    TrialDocument,
)
from msb.errors import InputError, shorten
from msb.metrics.images import most_psnr
from msb.metrics.registry import IMAGE_METRICS, mean_of
from msb.metrics.vgg import MOST_LPIPS, is_weights_record
from msb.registry import Tier

SCHEMA: Literal["msb.result/2"] = "msb.result/2"
# Most bytes of a record; it holds about 400 an image, and no dataset has 100,000 test views.
MAX_BYTES = 64 << 20
_MAX_TIMING = 1 << 16

Condition = Literal["non_engine", "dedicated", "standard", "exported_mesh"]
# The conditions: the method's own renderer, our two tiers, and the mesh itself, which is audited.
CONDITIONS: tuple[Condition, ...] = ("non_engine", "dedicated", "standard", "exported_mesh")
# Condition that has images -> the tier they are of, in the order in which quality is lost.
TIER_OF: Mapping[str, Tier] = MappingProxyType(
    {"non_engine": "reference", "dedicated": "dedicated", "standard": "standard"}
)

# The conditions that can be walked through: those of which we, an engine or a bake draw any view.
WALKED: tuple[Condition, ...] = ("dedicated", "standard")
# What the keys of conditions begin with in which a bake of the model is drawn.
BAKED = "baked"

# A tolerance for means: more than rounding does to one, less than what two numbers of a table differ by.
_ROUNDING = {"rel_tol": 1e-9, "abs_tol": 1e-9}

# No measurement is beyond it, and sums and squares of numbers below it are still numbers.
_MOST_NUMBER = 1e100
# More than nothing, so that others can be divided by it.
_Divisor = Annotated[float, Field(ge=1e-9)]

Status = Literal["done", "failed", "unsupported"]


class Reason(Record):
    """The reason why something is missing: an error code and its message."""

    code: Name
    message: str


class Cell(Record):
    """The identity of a result."""

    # "mipnerf360", "tanksandtemples", "nerf_synthetic", "dtu", or any other name for other captures.
    dataset: Name
    scene: Name
    # As `msb.registry` names it.
    method: Name
    # Tells the model from others of its method in one protocol, and names its columns.
    label: Name | None = None
    condition: Condition
    # The label of a variant of the dedicated tier: another order, sampling, renderer or settings.
    variant: Name | None = None
    # The label of a bake: the standard tier draws a plain asset that was made of the model.
    bake: Name | None = None
    # A renderer other than the condition's own, by its name in `msb.renderers`: an engine on the standard
    # tier, or what draws a variant.
    renderer: Name | None = None

    @property
    def model_name(self) -> str:
        """The model as tables and folders name it: by its label, else by its method."""
        return self.label or self.method

    @property
    def condition_name(self) -> str:
        """The condition's folder: named by its bake, variant or renderer, where it has one of its own."""
        return self.bake or self.variant or self.renderer or self.condition

    @property
    def condition_key(self) -> str:
        """The condition in tables: "standard"; "standard/wgpu" of an engine; "dedicated/NAME" a variant;
        "baked/NAME" a bake."""
        if self.bake is not None:
            return f"{BAKED}/{self.bake}"
        own = self.variant or self.renderer
        return self.condition if own is None else f"{self.condition}/{own}"

    @property
    def names(self) -> tuple[str, str, str, str]:
        """Dataset, scene, model and condition: the folders of the cell."""
        return self.dataset, self.scene, self.model_name, self.condition_name


class File(Record):
    """A file or folder behind a result; for a folder `sha256` is that of its list of hashes."""

    path: str
    bytes: Count
    sha256: Sha256 | None = None


class Setup(Record):
    """What must be equal before two results may be compared."""

    # The principal point: in the image's centre, as the 3DGS family trains, or as it is recorded.
    camera_convention: Literal["gs_fov", "full_K"]
    # The folder below the scene, such as "images_4".
    image_folder: str
    # Whether we resized the photographs because they are not shipped in this size.
    gt_resized: bool
    # The colour behind the model, and behind a masked photograph.
    background: tuple[float, float, float]
    mask_source: Literal["png_alpha", "mask_folder"] | None = None
    render_masked_by_gt_alpha: bool = False


class _Measured(Record):
    """Values by the keys of the image metrics, which in JSON stand among the other keys.

    A metric that is missing has no value, because a record may be older than the metric.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float | None]

    @property
    def values(self) -> dict[str, float | None]:
        """Every metric's value, by its key."""
        return {key: self.__pydantic_extra__.get(key) for key in IMAGE_METRICS}


class ImageQuality(_Measured):
    """One test image. PSNR is None where the images are equal, which `psnr_infinite` says."""

    name: Name
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    psnr_infinite: bool = False
    # The rendering's file, relative to the record.
    file: str
    # That of the file as it was compared.
    sha256: Sha256
    # The ground truth's file as it was compared, relative to the record.
    gt: str


class Quality(_Measured):
    """Unweighted means over the test images, and every image; `psnr_inf_count` counts infinite PSNRs."""

    # Why metrics that need VGG weights are missing.
    lpips_reason: str | None
    psnr_inf_count: Count
    images: tuple[ImageQuality, ...]
    # The full identity of every metric (`msb.metrics.identity`).
    metrics: tuple[dict[str, Any], ...]
    # Metric of a package -> the reason why it has no value.
    missing: dict[Name, str] = Field(default_factory=dict)

    @property
    def views(self) -> frozenset[tuple[str, int, int]]:
        """Name, width and height of every image."""
        return frozenset((image.name, image.width, image.height) for image in self.images)

    @property
    def not_installed(self) -> set[str]:
        """The metrics of packages that were there when this was measured, and are not here."""
        return {key for one in (self, *self.images) for key in one.__pydantic_extra__} - set(IMAGE_METRICS)

    @model_validator(mode="after")
    def _are_metrics(self) -> Self:
        if unknown := self.not_installed - {str(one.get("name")) for one in self.metrics}:
            raise ValueError(f"there is no metric {shorten(min(unknown))!r}")
        return self


class Timing(Record):
    """Milliseconds of a pass that wrote and read back nothing; percentiles are over all timed frames."""

    frames: Annotated[int, Field(gt=0)]
    # Wall-clock seconds of all `frames`.
    seconds: Amount
    fps: _Divisor
    # Device time from the start of a frame's first command to the end of its last one.
    p50_ms: Amount
    p95_ms: Amount
    mean_ms: Amount
    busy_p50_ms: Amount
    busy_p95_ms: Amount
    # From when the first command was queued; None if the renderer cannot tell.
    queued_p50_ms: Amount | None
    queued_p95_ms: Amount | None
    # The rates of up to five rounds of consecutive frames, far apart on a machine with other work.
    round_fps: tuple[Amount, ...]
    stages_ms: dict[str, Amount]
    # "Device ms" are GPU ms only where this is "gpu".
    device_kind: Literal["gpu", "cpu", "other"]

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if not math.isclose(self.fps * self.seconds, self.frames, rel_tol=1e-6):
            text = f"{self.frames} frames in {self.seconds:g} s are no {self.fps:g} frames a second"
            raise ValueError(text)
        for kind in ("", "busy_", "queued_"):
            p50, p95 = (getattr(self, f"{kind}{name}") for name in ("p50_ms", "p95_ms"))
            if (p50 or 0) > (p95 or 0) * (1 + 1e-9):
                raise ValueError(f"{kind}p50_ms is {p50:g}, and {kind}p95_ms less")
        return self


class Memory(Record):
    """Bytes of our buffers on the device after all test views were drawn, by what they are for.

    Buffers only grow from view to view, so each has the size that the most demanding view needs.
    """

    geometry: Count
    appearance: Count
    # Order, tile lists, and intermediate results of a frame.
    scratch: Count
    # Colour and depth.
    targets: Count
    # The same bytes by the renderer's own names of uses.
    uses: dict[str, Count]
    # All that the process held on NVIDIA's GPUs then, by NVML; `driver_reason` says why if it is None.
    driver_bytes: Count | None = None
    driver_reason: str | None = None

    @property
    def total(self) -> int:
        """The sum of all groups."""
        return self.geometry + self.appearance + self.scratch + self.targets


class Floor(Record):
    """What the renderer takes for one triangle of the model at this size: not for the mesh."""

    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    p50_ms: Amount
    p95_ms: Amount
    memory_bytes: Count


class RendererTiming(Record):
    """How fast a method's own renderer is, measured elsewhere by the user: schema msb.renderer_timing/1."""

    schema_: Literal["msb.renderer_timing/1"] = Field(default="msb.renderer_timing/1", alias="schema")
    frames: Annotated[int, Field(gt=0)]
    # The wall-clock time of all frames.
    seconds: _Divisor
    # What rendered them: "NVIDIA RTX 4090".
    device: Name
    # What was timed, in words: "render() of 300 test views after a warm-up, nothing written".
    timed: Name
    # Whether loading and writing are included, so that nothing else may be held against this time.
    whole_command: bool = False
    peak_gpu_memory_bytes: Count | None = None

    @property
    def fps(self) -> float:
        """Frames per second of wall-clock time."""
        return self.frames / self.seconds


class WalkDocument(Record):
    """What a walk off the path of the capture shows of a condition (`msb.bench.walk`)."""

    frames: Count
    width: Count
    height: Count
    # Root mean square in levels of 255 of `msb.metrics.steadiness.unexplained_change` over all frames.
    flicker: Amount
    # The same over the worst second.
    flicker_worst: Amount
    # The number of its first frame; the walk begins with 0.
    worst_frame: Count
    # Pixels of `msb.metrics.steadiness.holes` as a share of those that show the model or are such.
    holes: Share
    # The file of the worst second, beside the record; None without the extra `video`.
    film: str | None
    seconds: Amount


class Training(Record):
    """What training cost, from the user's own record (`msb track`); never estimated."""

    seconds: Amount | None
    peak_memory_bytes: Count | None
    source: str


class RendererInfo(Record):
    """The renderer of the images: "upstream" for official files, "msb_reference" for our NumPy renderer."""

    name: str
    version: str
    kind: Literal["msb", "upstream", "msb_reference", "engine"]
    settings: dict[str, bool | int | float | str | None] = Field(default_factory=dict)


class Result(Record):
    """One cell's record.

    `status` "unsupported" prints N/A, "failed" prints --; both have a `reason`. Parts that do not apply to
    the condition are None. A cell is done when its images were compared, or its mesh audited; `reasons` says
    why other parts that were asked for are missing.
    """

    schema_: Literal["msb.result/2"] = Field(default=SCHEMA, alias="schema")
    tool_version: str = __version__
    cell: Cell
    status: Status
    reason: Reason | None = None
    # The time that the cell took.
    seconds: Amount
    setup: Setup | None = None
    checkpoint: File | None = None
    asset: File | None = None
    # The asset that a bake was made of; that of the bake is `asset`.
    source: File | None = None
    # The folder of official renderings, in the condition non_engine only.
    renders: File | None = None
    renderer: RendererInfo | None = None
    device: dict[str, Any] | None = None
    quality: Quality | None = None
    timing: Timing | None = None
    memory: Memory | None = None
    floor: Floor | None = None
    # For DTU only.
    chamfer: ChamferDocument | None = None
    # Of an exported mesh and of a bake, as is `trial`.
    audit: AuditDocument | None = None
    bake: BakeDocument | None = None
    # Pictures lie in "trial" beside the record.
    trial: TrialDocument | None = None
    # Of an exported mesh only; pictures lie in "repairs".
    repairs: RepairDocument | None = None
    # Of conditions that our renderers or engines draw, if the protocol has a walk.
    walk: WalkDocument | None = None
    training: Training | None = None
    trained: tuple[Name, ...] = ()  # sentences on its split, background or size, where they are others
    # Of the method's own renderer, measured elsewhere; condition non_engine only.
    renderer_timing: RendererTiming | None = None
    # Part ("timing", "walk", "trial", "repairs", "chamfer", "training") -> the reason why it is missing.
    reasons: dict[Name, Reason] = Field(default_factory=dict)
    # Part -> its inputs, name -> hash or version; one that changed is computed again.
    inputs: dict[Name, dict[Name, str]] = Field(default_factory=dict)

    @property
    def model_asset(self) -> File | None:
        """The asset of the model: of a bake what it was made of, else what was drawn."""
        return self.source or self.asset

    @property
    def drawn_on(self) -> dict[str, Any]:
        """What is known of the device that drew, or the engine; empty where nothing is."""
        device = (self.device or {}).get("device")
        return device if isinstance(device, dict) else {}


def read_renderer_timing(path: str | os.PathLike[str]) -> RendererTiming:
    """Return the measurement in the file `path`."""
    return checked(RendererTiming, read_json(path, _MAX_TIMING), file=path, code="RECORD_INVALID")


def read_result(path: str | os.PathLike[str]) -> Result:
    """Return the record in the file `path`."""
    return checked_result(read_json(path, MAX_BYTES), file=Path(path))


def checked_result(data: Any, *, file: object) -> Result:
    """Return the record that JSON data of a file is, if its numbers are possible and its means true."""
    _refuse(_too_large(data), file)
    result = checked(Result, data, file=file, code="RECORD_INVALID")
    _refuse(() if result.quality is None else _impossible(result.quality), file)
    return result


def _refuse(wrong: Iterable[tuple[str, str]], file: object) -> None:
    for pointer, text in wrong:
        raise InputError("RECORD_INVALID", f"{pointer}: {text}", file=file, pointer=pointer)


def _too_large(data: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """Yield place and fault of numbers in JSON data that nothing measures, wherever they stand."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _too_large(value, f"{place}/{key}")
    elif isinstance(data, int | float) and abs(data) > _MOST_NUMBER:
        yield place, f"{data:g} is no measurement"


def _bounds(image: ImageQuality) -> dict[str, tuple[float, float]]:
    """Return our image metric -> the least and the most that it can be of images of a size, but infinity."""
    # The values are bytes over 255: a mean squared error is at most 1.
    return {
        "psnr": (0.0, most_psnr(image.width * image.height)),
        "ssim": (-1.0, 1.0),
        "lpips": (0.0, MOST_LPIPS),
    }


def _impossible(quality: Quality) -> Iterator[tuple[str, str]]:
    """Yield place and fault of what no comparison of images gives."""
    for number, identity in enumerate(quality.metrics):
        weights = identity.get("weights") if identity.get("name") == IMAGE_METRICS["lpips"].name else None
        if weights and not is_weights_record(weights):
            yield (
                f"/quality/metrics/{number}/weights",
                "it does not say which VGG16 and linear layers they are",
            )
    for number, image in enumerate(quality.images):
        pointer, psnr = f"/quality/images/{number}", image.values["psnr"]
        if (psnr is None) is not image.psnr_infinite:
            yield f"{pointer}/psnr", "it must be there, or psnr_infinite be true, and not both"
        for key, (least, most) in _bounds(image).items():
            value, metric = image.values[key], IMAGE_METRICS[key]
            if value is None or least - 1e-9 <= value <= most + 1e-9:
                continue
            unit = "" if metric.unit == "1" else f" {metric.unit}"
            bound = f"above {most:.4g}" if value > most else "negative" if least == 0 else f"below {least:g}"
            yield f"{pointer}/{key}", f"{value:g}{unit}, and no {metric.title} is {bound}"
    if not quality.images:
        yield "/quality/images", "there are none"
        return
    infinite = sum(image.psnr_infinite for image in quality.images)
    if quality.psnr_inf_count != infinite:
        yield "/quality/psnr_inf_count", f"it is {quality.psnr_inf_count}, and so many images are {infinite}"
    means = means_of(quality.images)
    for name, held in quality.values.items():
        value = means[name]
        if (held is None) is not (value is None) or not math.isclose(held or 0, value or 0, **_ROUNDING):
            yield f"/quality/{name}", f"it is {held}, and the mean of its images is {value}"


def means_of(images: Sequence[ImageQuality]) -> dict[str, float | None]:
    """Return metric -> the mean of its values, None if an image has no value."""
    return {
        key: mean_of(
            math.inf if key == "psnr" and image.psnr_infinite else image.values[key] for image in images
        )
        for key in IMAGE_METRICS
    }
