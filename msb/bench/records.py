"""Result records: JSON files with the measurements of one benchmark cell (dataset, scene, method, condition).

`msb run` writes the records, and `msb report` reads them. Values have full precision. The units are seconds,
milliseconds, bytes and the units of the metrics. A missing value is None. The record contains the reason. The
file is described in docs/protocol.md.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from msb.base.version import __version__
from msb.bench.documents import (
    AuditDocument,
    BakeDocument,
    ChamferDocument,
    RepairDocument,
    Share,
    TrialDocument,
)
from msb.bench.validation import Amount, Count, Name, Record, Sha256, read_json, validate
from msb.errors import InputError, shorten
from msb.metrics.images import find_max_psnr
from msb.metrics.registry import IMAGE_METRICS, mean_of
from msb.metrics.vgg import MOST_LPIPS, is_weights_record
from msb.registry import Tier

SCHEMA: Literal["msb.result/2"] = "msb.result/2"
# Maximum size of a record in bytes. The record of an image has about 400 bytes, so the limit allows 100,000
# test views.
MAX_BYTES = 64 << 20
# Maximum number of frame times in a record. The JSON text of 20,000 times takes 160 kB. A timing of 3 s, the
# default, has fewer frames than this maximum.
MOST_FRAME_TIMES = 20_000
# Maximum size of a file of the schema msb.renderer_timing/1 in bytes.
_MAX_TIMING = 1 << 16

Condition = Literal["non_engine", "dedicated", "standard", "exported_mesh"]
# The conditions of the benchmark: native renderer, two engine tiers, and exported mesh. The exported mesh is
# audited but not rendered.
CONDITIONS: tuple[Condition, ...] = ("non_engine", "dedicated", "standard", "exported_mesh")
# The tier that renders each condition with images. The conditions are sorted by decreasing quality.
TIER_OF: Mapping[str, Tier] = MappingProxyType(
    {"non_engine": "reference", "dedicated": "dedicated", "standard": "standard"}
)

# Conditions that are measured on the camera path (walk), because their renderers accept arbitrary cameras.
WALKED: tuple[Condition, ...] = ("dedicated", "standard")
# Names of bake conditions begin with this word.
BAKED = "baked"

# Tolerance for recorded averages. The tolerance is larger than rounding errors, and smaller than one unit of
# the last printed digit.
_ROUNDING = {"rel_tol": 1e-9, "abs_tol": 1e-9}

# If a part of a record contains a larger number, the record is rejected. Sums and squares of accepted numbers
# do not overflow.
_MAX_NUMBER = 1e100
# A positive number. The lower limit avoids division by values close to zero.
_Divisor = Annotated[float, Field(ge=1e-9)]

Status = Literal["done", "failed", "unsupported"]


class Reason(Record):
    """An error code and its message, which explain a missing value."""

    code: Name
    message: str


class Cell(Record):
    """The identity of a result."""

    # Dataset name: "mipnerf360", "tanksandtemples", "nerf_synthetic", "dtu", or any name for other captures.
    dataset: Name
    scene: Name
    # Method name in `msb.registry`.
    method: Name
    # The label distinguishes models of one method in a protocol, and names the columns of the model.
    label: Name | None = None
    condition: Condition
    # The label of a variant: the dedicated tier with another order, sampling, renderer or settings.
    variant: Name | None = None
    # The label of a bake: a standard-tier mesh that was baked from the model.
    bake: Name | None = None
    # The name in `msb.renderers` of the engine that renders the benchmark cell, or of a variant's renderer.
    renderer: Name | None = None

    @property
    def model_name(self) -> str:
        """The name of the model in tables and folders.

        The name is the label, or the method if there is no label.
        """
        return self.label or self.method

    @property
    def condition_name(self) -> str:
        """The folder name of the condition.

        The name is the bake, variant or renderer if given, otherwise the condition.
        """
        return self.bake or self.variant or self.renderer or self.condition

    @property
    def condition_key(self) -> str:
        """The condition in tables, such as "standard".

        The name of an engine is "standard/NAME", of a variant "dedicated/NAME", and of a bake "baked/NAME".
        """
        if self.bake is not None:
            return f"{BAKED}/{self.bake}"
        suffix = self.variant or self.renderer
        return self.condition if suffix is None else f"{self.condition}/{suffix}"

    @property
    def names(self) -> tuple[str, str, str, str]:
        """Dataset, scene, model and condition; these names are the folders of the benchmark cell."""
        return self.dataset, self.scene, self.model_name, self.condition_name


class File(Record):
    """An input file or folder of a result. The hash of a folder is the SHA-256 of its list of hashes."""

    path: str
    bytes: Count
    sha256: Sha256 | None = None


class Setup(Record):
    """The conditions under which two results are compared.

    Two results are comparable only if these conditions are equal.
    """

    # Principal point in the image centre, as in 3DGS ("gs_fov"), or as recorded ("full_K").
    camera_convention: Literal["gs_fov", "full_K"]
    # The folder of the photographs below the scene, such as "images_4".
    image_folder: str
    # Whether the photographs were resized because the dataset provides no images of this size.
    gt_resized: bool
    # Colour behind the model and behind masked photographs, as RGB from 0 to 1.
    background: tuple[float, float, float]
    mask_source: Literal["png_alpha", "mask_folder", "mask_path"] | None = None
    render_masked_by_gt_alpha: bool = False


class _MetricValues(Record):
    """Values of the image metrics, stored as additional keys of the JSON object.

    An older record may lack a newer metric.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float | None]

    @property
    def values(self) -> dict[str, float | None]:
        """For the key of each metric, its value or None."""
        return {key: self.__pydantic_extra__.get(key) for key in IMAGE_METRICS}


class ImageQuality(_MetricValues):
    """The metrics of one test image. If the images are equal, PSNR is None and `psnr_infinite` is true."""

    name: Name
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    psnr_infinite: bool = False
    # Path of the rendering, relative to the record.
    file: str
    # SHA-256 of the rendering at the time of its comparison.
    sha256: Sha256
    # Path of the ground truth, relative to the record.
    gt: str


class Quality(_MetricValues):
    """Unweighted averages over the test images, and the metrics of every image."""

    # The reason that LPIPS is missing.
    lpips_reason: str | None
    # Number of images with infinite PSNR.
    psnr_inf_count: Count
    images: tuple[ImageQuality, ...]
    # The identity of every metric (`msb.metrics.identity`), with version and parameters.
    metrics: tuple[dict[str, Any], ...]
    # For each missing metric of another package, the reason why the metric has no value.
    missing: dict[Name, str] = Field(default_factory=dict)

    @property
    def views(self) -> frozenset[tuple[str, int, int]]:
        """Name, width and height of every image."""
        return frozenset((image.name, image.width, image.height) for image in self.images)

    @property
    def not_installed(self) -> set[str]:
        """Metrics in the record whose packages are not installed on this machine."""
        keys = {key for part in (self, *self.images) for key in part.__pydantic_extra__}
        return keys - set(IMAGE_METRICS)

    @model_validator(mode="after")
    def _check_metrics(self) -> Self:
        if unknown := self.not_installed - {str(identity.get("name")) for identity in self.metrics}:
            raise ValueError(f"{shorten(min(unknown))!r} is not a metric")
        return self


class Timing(Record):
    """Frame times of a renderer, without writing images and without reading images back.

    Percentiles are over all timed frames.
    """

    frames: Annotated[int, Field(gt=0)]
    # Wall-clock time of all frames together, in seconds.
    seconds: Amount
    # Frames per second of wall-clock time.
    fps: _Divisor
    # Device time from the start of the first command of a frame to the end of its last command.
    p50_ms: Amount
    p95_ms: Amount
    mean_ms: Amount
    # Sum of the times of all commands of a frame.
    busy_p50_ms: Amount
    busy_p95_ms: Amount
    # Device time from the queueing of the first command. The value is None if the renderer cannot measure
    # this time.
    queued_p50_ms: Amount | None
    queued_p95_ms: Amount | None
    # Frame rates of up to five consecutive parts (rounds) of the timing. If other programs use the machine,
    # the rounds have different frame rates.
    round_fps: tuple[Amount, ...]
    # Device time of each frame in units of 0.1 microseconds. Long timings keep only evenly spread frames.
    # Older records have no frame times.
    frame_ms: Annotated[tuple[Amount, ...], Field(max_length=MOST_FRAME_TIMES)] = ()
    # Median time of each renderer stage in milliseconds.
    stages_ms: dict[str, Amount]
    device_kind: Literal["gpu", "cpu", "other"]

    @property
    def has_device_times(self) -> bool:
        """Whether the renderer measured times on its device. The value is false if all device times are 0."""
        return self.mean_ms > 0

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if not math.isclose(self.fps * self.seconds, self.frames, rel_tol=1e-6):
            text = f"fps is {self.fps:g}, but {self.frames} frames took {self.seconds:g} s"
            raise ValueError(text)
        for kind in ("", "busy_", "queued_"):
            p50, p95 = (getattr(self, f"{kind}{name}") for name in ("p50_ms", "p95_ms"))
            if (p50 or 0) > (p95 or 0) * (1 + 1e-9):
                raise ValueError(f"{kind}p50_ms is {p50:g}, which exceeds the value of {kind}p95_ms")
        if len(self.frame_ms) == self.frames:
            for name, percent in (("p50_ms", 50), ("p95_ms", 95)):
                recorded, value = getattr(self, name), float(np.percentile(self.frame_ms, percent))
                if not math.isclose(recorded, value, rel_tol=1e-6, abs_tol=1e-3):
                    raise ValueError(f"{name} is {recorded:g}, but frame_ms gives {value:g}")
        return self


class Memory(Record):
    """Bytes of our device buffers after all test views were drawn, by purpose.

    Buffers never shrink, so each buffer has the size that the largest view needs.
    """

    geometry: Count
    appearance: Count
    # Bytes of intermediate data of a frame, such as the sort order and tile lists.
    scratch: Count
    # Bytes of colour and depth images.
    targets: Count
    # Bytes of each buffer, by the buffer's name in the renderer.
    uses: dict[str, Count]
    # Bytes of the process on NVIDIA GPUs, measured by NVML. `driver_reason` explains a missing number.
    driver_bytes: Count | None = None
    driver_reason: str | None = None

    @property
    def total(self) -> int:
        """The total bytes of all buffers."""
        return self.geometry + self.appearance + self.scratch + self.targets


class Floor(Record):
    """Time and memory of the renderer for a single triangle at this image size.

    The cost of a single triangle is the fixed cost of drawing any mesh.
    """

    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    p50_ms: Amount
    p95_ms: Amount
    memory_bytes: Count


class RendererTiming(Record):
    """The speed of a method's official renderer as measured by the user, schema msb.renderer_timing/1."""

    schema_: Literal["msb.renderer_timing/1"] = Field(default="msb.renderer_timing/1", alias="schema")
    frames: Annotated[int, Field(gt=0)]
    # Wall-clock time of all frames together, in seconds.
    seconds: _Divisor
    # Name of the rendering device, such as "NVIDIA RTX 4090".
    device: Name
    # Description of the measurement, such as "render() of 300 test views after a warm-up, nothing written".
    timed: Name
    # Whether the times include loading and writing. Times that include loading or writing are not compared
    # with other times.
    whole_command: bool = False
    peak_gpu_memory_bytes: Count | None = None

    @property
    def fps(self) -> float:
        """Frames per second of wall-clock time."""
        return self.frames / self.seconds


class WalkDocument(Record):
    """Flicker and holes on a walk: a camera path away from the captured views (`msb.bench.walk`)."""

    frames: Count
    width: Count
    height: Count
    # Root mean square of `msb.metrics.steadiness.unexplained_change` over all frames, in levels of 255.
    flicker: Amount
    # The flicker during the second of the walk with the most flicker.
    flicker_worst: Amount
    # Index of the first frame of the second with the most flicker.
    worst_frame: Count
    # Fraction of hole pixels (`msb.metrics.steadiness.find_holes`) among all pixels that show the model or a
    # hole.
    holes: Share
    # Name of a video file beside the record. The video shows the one second that flickers most. Without the
    # extra `video`, the value is None.
    film: str | None
    seconds: Amount


class Training(Record):
    """Time and memory of a training run, from a record of `msb track` or from the log of our trainer."""

    seconds: Amount | None
    peak_memory_bytes: Count | None
    source: str
    # The reason that the peak memory is unknown.
    memory_reason: str | None = None
    # The value is "ours" for models of our trainer (docs/training.md), which runs on a CPU.
    trainer: Literal["official", "ours"] = "official"


class RendererInfo(Record):
    """The renderer of the images.

    `kind` is "upstream" for official renderings, and "msb_reference" for our NumPy renderer.
    """

    name: str
    version: str
    kind: Literal["msb", "upstream", "msb_reference", "engine"]
    settings: dict[str, bool | int | float | str | None] = Field(default_factory=dict)


class Result(Record):
    """The record of one benchmark cell.

    A benchmark cell is "done" if its images were compared or its mesh was audited. Tables print the status
    "unsupported" as N/A and "failed" as --. Records with the status "unsupported" or "failed" have a
    `reason`. Parts that do not apply to the condition are None. Requested parts that are missing have a
    reason in `reasons`.
    """

    schema_: Literal["msb.result/2"] = Field(default=SCHEMA, alias="schema")
    tool_version: str = __version__
    cell: Cell
    status: Status
    reason: Reason | None = None
    # Seconds spent on computing the benchmark cell.
    seconds: Amount
    setup: Setup | None = None
    checkpoint: File | None = None
    asset: File | None = None
    # For a bake, this is the asset before the bake, and `asset` is the baked mesh.
    source: File | None = None
    # The folder of official renderings, only for the condition non_engine.
    renders: File | None = None
    renderer: RendererInfo | None = None
    device: dict[str, Any] | None = None
    quality: Quality | None = None
    timing: Timing | None = None
    memory: Memory | None = None
    floor: Floor | None = None
    # Only for DTU.
    chamfer: ChamferDocument | None = None
    # Audits and trials exist only for exported meshes and bakes.
    audit: AuditDocument | None = None
    bake: BakeDocument | None = None
    # The folder "trial" beside the record contains the images of a trial.
    trial: TrialDocument | None = None
    # Comparison of repairs, for exported meshes only. The images are in the folder "repairs".
    repairs: RepairDocument | None = None
    # A camera path (walk) is measured only if the protocol requests it, and only for conditions that our
    # renderers or an engine draw.
    walk: WalkDocument | None = None
    training: Training | None = None
    # Notes on differences between training and evaluation: split, background and image size.
    trained: tuple[Name, ...] = ()
    # The user's timing of the method's official renderer; only for the condition non_engine.
    renderer_timing: RendererTiming | None = None
    # The reason for each missing part ("timing", "walk", "trial", "repairs", "chamfer", "training").
    reasons: dict[Name, Reason] = Field(default_factory=dict)
    # The hash or version of each input, by the names of part and input. If an input changes, each part that
    # depends on this input is computed again.
    inputs: dict[Name, dict[Name, str]] = Field(default_factory=dict)

    @property
    def model_asset(self) -> File | None:
        """The asset of the model. For a bake, return the asset before the bake."""
        return self.source or self.asset

    @property
    def drawn_on(self) -> dict[str, Any]:
        """The name of the rendering device or engine; empty if unknown."""
        device = (self.device or {}).get("device")
        return device if isinstance(device, dict) else {}


def read_renderer_timing(path: str | os.PathLike[str]) -> RendererTiming:
    """Return the timing of a method's official renderer in the file `path`."""
    return validate(RendererTiming, read_json(path, _MAX_TIMING), file=path, code="RECORD_INVALID")


def read_result(path: str | os.PathLike[str]) -> Result:
    """Return the record in the file `path`."""
    return validate_result(read_json(path, MAX_BYTES), file=Path(path))


def validate_result(data: Any, *, file: object) -> Result:
    """Return JSON data as a record, after checking the ranges of numbers and the averages over images."""
    _raise_first(_find_huge_numbers(data), file)
    result = validate(Result, data, file=file, code="RECORD_INVALID")
    _raise_first(() if result.quality is None else _find_quality_errors(result.quality), file)
    return result


def _raise_first(errors: Iterable[tuple[str, str]], file: object) -> None:
    """Raise the first error in a sequence of pairs (JSON pointer, text)."""
    for pointer, text in errors:
        raise InputError("RECORD_INVALID", f"{pointer}: {text}", file=file, pointer=pointer)


def _find_huge_numbers(data: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """Yield (JSON pointer, text) for each number in JSON data that is too large for a measurement."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _find_huge_numbers(value, f"{place}/{key}")
    elif isinstance(data, int | float) and abs(data) > _MAX_NUMBER:
        yield place, f"{data:g} is too large for a measurement"


def _get_bounds(image: ImageQuality) -> dict[str, tuple[float, float]]:
    """Return the minimum and maximum finite value of each metric for an image of this size."""
    # Colour values are between 0 and 1, so the mean squared error is at most 1.
    return {
        "psnr": (0.0, find_max_psnr(image.width * image.height)),
        "ssim": (-1.0, 1.0),
        "lpips": (0.0, MOST_LPIPS),
    }


def _find_quality_errors(quality: Quality) -> Iterator[tuple[str, str]]:
    """Yield (JSON pointer, text) for each invalid value of an image comparison."""
    for number, identity in enumerate(quality.metrics):
        weights = identity.get("weights") if identity.get("name") == IMAGE_METRICS["lpips"].name else None
        if weights and not is_weights_record(weights):
            yield (
                f"/quality/metrics/{number}/weights",
                "the record does not identify the weights of VGG16 and the linear layers",
            )
    # Check that every image has a valid value of each metric, or is marked as equal to the photograph.
    for number, image in enumerate(quality.images):
        pointer, psnr = f"/quality/images/{number}", image.values["psnr"]
        if (psnr is None) is not image.psnr_infinite:
            yield f"{pointer}/psnr", "exactly one of psnr and psnr_infinite must be given"
        for key, (least, most) in _get_bounds(image).items():
            value, metric = image.values[key], IMAGE_METRICS[key]
            if value is None or least - 1e-9 <= value <= most + 1e-9:
                continue
            unit = "" if metric.unit == "1" else f" {metric.unit}"
            text = f"{metric.title} is {value:g}{unit}; it must be between {least:g} and {most:.4g}"
            yield f"{pointer}/{key}", text
    if not quality.images:
        yield "/quality/images", "the list of images is empty"
        return
    # The recorded averages are compared with averages that are computed from the images.
    infinite = sum(image.psnr_infinite for image in quality.images)
    if quality.psnr_inf_count != infinite:
        text = f"the value is {quality.psnr_inf_count}, but {infinite} images have an infinite PSNR"
        yield "/quality/psnr_inf_count", text
    averages = average_images(quality.images)
    for name, recorded in quality.values.items():
        value = averages[name]
        missing = (recorded is None) is not (value is None)
        if missing or not math.isclose(recorded or 0, value or 0, **_ROUNDING):
            yield f"/quality/{name}", f"the value is {recorded}, but the average of the images is {value}"


def average_images(images: Sequence[ImageQuality]) -> dict[str, float | None]:
    """Return the average of each metric over the images, or None if an image has no value."""
    return {
        key: mean_of(
            math.inf if key == "psnr" and image.psnr_infinite else image.values[key] for image in images
        )
        for key in IMAGE_METRICS
    }
