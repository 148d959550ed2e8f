"""`msb eval`: compare images with their ground truth by image metrics."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msb.base.extras import need_extra
from msb.base.option import Argument, Option
from msb.cli.command import Typed, command
from msb.cli.output import Cell, Output, report_error
from msb.errors import EXIT_STATUS, MsbError, about, shorten
from msb.render.options import SCENE_OPTIONS, SceneOptions, parse_color_option

if TYPE_CHECKING:
    from msb.metrics import ImagePair
    from msb.scenes.colors import Color

NOTHING_SHOWN = "every image in PRED is uniform and shows nothing, so no metric is computed"
NO_WEIGHTS = "no VGG weights (--vgg-weights FILE)"
_COLUMNS = ("name", "pred", "gt", "width", "height")


@dataclass(frozen=True)
class EvalOptions:
    """Options for the comparison of images."""

    vgg_weights: Annotated[
        Path | None,
        Option("Weights for LPIPS: vgg16-397923af.pth of torchvision.", metavar="FILE"),
    ] = None
    background: Annotated[
        str | None,
        Option(
            "Blend images with alpha over this colour: black, white, #rrggbb or r,g,b in 0..1.",
            metavar="COLOR",
        ),
    ] = None
    subset: Annotated[bool, Option("Allow images in GT that are not in PRED.")] = False


@command(
    "msb eval data_stubs/scenes/tanksandtemples/pebble/images/000001.jpg \\\n"
    "      data_stubs/scenes/tanksandtemples/pebble/images/000002.jpg",
    "msb eval --json - data_stubs/scenes/mipnerf360/pebble/images_4 \\\n"
    "      data_stubs/scenes/mipnerf360/pebble/images_4",
    name="eval",
)
def evaluate(
    pred: Annotated[Path, Argument("Folder of images, or one image.", metavar="PRED")],
    gt: Annotated[
        Path,
        Argument("Ground truth: an image, a folder with the same file names, or a scene.", metavar="GT"),
    ],
    options: EvalOptions,
    reading: SceneOptions,
    output: Annotated[Output, ("json_file", "csv_file", "fail_fast", "force", "quiet", "verbose")],
    typed: Typed,
) -> int:
    """Compare images with their ground truth by PSNR, SSIM, LPIPS and other metrics.

    Two images form a pair if their paths relative to the folders are equal. The file extensions of a pair
    (png, jpg, npy, exr) may differ. The images of a pair must have equal sizes, because images are not
    resized. All pixel values are clamped and rounded to 8 bits. For an invalid image, a line is printed on
    standard error and the exit status is 3. The remaining images are still compared.

    If GT is a scene, its test photographs are the ground truth, undistorted, masked and resized as in msb
    run.
    """
    color = None if options.background is None else parse_color_option(options.background)
    from msb.metrics import pair_images
    from msb.scenes.datasets.layout import find_layout

    if not gt.is_dir() or find_layout(gt) is None:
        typed.reject(SCENE_OPTIONS, "needs a scene as GT")
        pairs = pair_images(pred, gt, subset=options.subset)
        return _Comparison(output, pred, gt, options.vgg_weights, color).run(pairs)
    with tempfile.TemporaryDirectory(prefix="msb-eval-") as folder:
        photographs = _write_photographs(gt, Path(folder), reading, color, output)
        pairs = pair_images(pred, folder, subset=options.subset)
        return _Comparison(output, pred, gt, options.vgg_weights, color, photographs).run(pairs)


def _write_photographs(
    path: Path, folder: Path, reading: SceneOptions, color: Color | None, output: Output
) -> dict[Path, Path]:
    """Write the prepared test photographs of a scene.

    Return the photograph that belongs to each written file.
    """
    from msb.metrics.ground_truth import ground_truth
    from msb.render.images import image_names, write_image
    from msb.scenes import read_scene

    scene = read_scene(path, background=color, **reading.given)
    for warning in scene.warnings:
        output.note(warning.to_line(warning.file or path))
    photographs: dict[Path, Path] = {}
    with output.counted("reading photographs", len(scene.test)) as step:
        for name, camera in zip(image_names(scene.test), scene.test, strict=True):
            file = folder / f"{name}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            write_image(file, ground_truth(scene, camera), "png")
            if camera.image_path is not None:
                photographs[file] = camera.image_path
            step()
    return photographs


class _Comparison:
    """Compares pairs of images, prints the results and writes files."""

    def __init__(
        self,
        output: Output,
        pred: Path,
        gt: Path,
        vgg_weights: Path | None,
        color: Color | None,
        photographs: Mapping[Path, Path] | None = None,
    ) -> None:
        from msb.metrics import IMAGE_METRICS, Measures

        self.output, self.pred, self.gt, self.background = output, pred, gt, color
        # The photograph from which each ground-truth file was written.
        self.photographs = photographs or {}
        self.reason = NO_WEIGHTS if vgg_weights is None else None
        self.metrics = IMAGE_METRICS
        with nullcontext() if vgg_weights is None else output.progress(f"reading {vgg_weights.name}"):
            self.measures = Measures(vgg_weights)
        # For each pair of images, whether the image is uniform, and whether its ground truth is uniform.
        self.uniform: list[tuple[bool, bool]] = []
        self.notes = [warning.to_line(vgg_weights) for warning in self.measures.warnings]

    def run(self, pairs: list[ImagePair]) -> int:
        """Compare all pairs, print and write the results, and return the exit status."""
        from msb.metrics.registry import modules_needed

        rows: list[dict[str, Any]] = []
        failed: list[dict[str, Any]] = []
        status = 0
        # For each error message, the number of pairs with this error.
        counts: Counter[str] = Counter()
        # Missing libraries are reported once, before the first pair.
        read = ["OpenEXR"] if any(".exr" in (p.pred.suffix, p.gt.suffix) for p in pairs) else []
        need_extra("bench", *modules_needed(), *read, what="msb eval")
        for note in self.notes:
            self.output.note(note)
        with self.output.counted("comparing", len(pairs)) as step:
            for pair in pairs:
                try:
                    rows.append(self.compare(pair))
                except MsbError as error:
                    # Repeated errors about sizes are printed only for the first image.
                    repeated = error.code == "METRIC_SIZES_DIFFER" and counts[error.message] > 0
                    status = max(status, EXIT_STATUS[type(error)] if repeated else report_error(error))
                    counts[error.message] += 1
                    failed.append({"name": pair.name, "code": error.code, "message": str(error)})
                    if self.output.fail_fast:
                        break
                step()
        for failed_metric in self.measures.failed.values():
            self.notes.append(f"warning: {failed_metric}; no average of this metric is computed")
            self.output.note(self.notes[-1])
        for message, count in counts.items():
            if count > 1:
                self.output.note(f"{count} of {len(pairs)} images have the same error: {message}")
        # If all images are uniform and the ground truth is not, the images do not show the model. Metrics of
        # images that do not show the model would be misleading.
        is_empty = bool(rows) and all(a for a, _ in self.uniform) and not all(b for _, b in self.uniform)
        if is_empty:
            rows = [{**row, **dict.fromkeys(self.metrics)} for row in rows]
        data = self.make_document(rows, failed) | ({"reason": NOTHING_SHOWN} if is_empty else {})
        if self.output.prints_text and rows:
            self.print_table(rows, data)
        self.output.write_json(data)
        self.output.write_csv((*_COLUMNS, *self.metrics), rows)
        return status

    def compare(self, pair: ImagePair) -> dict[str, Any]:
        """Return the row of a pair of images: names, size and metrics."""
        from msb import metrics
        from msb.metrics.images import is_plain

        pred, gt = (metrics.read_image(path, background=self.background) for path in (pair.pred, pair.gt))
        self.uniform.append((is_plain(pred), is_plain(gt)))
        with about(pair.pred):
            return {
                "name": pair.name,
                "pred": str(pair.pred),
                "gt": str(self.photographs.get(pair.gt, pair.gt)),
                "width": int(gt.shape[1]),
                "height": int(gt.shape[0]),
                **self.measures(pred, gt),
            }

    def make_document(self, rows: list[dict[str, Any]], failed: list[dict[str, Any]]) -> dict[str, Any]:
        """Return the JSON document. Averages include only the images that could be compared."""
        from msb.errors import json_safe
        from msb.metrics.registry import mean_of

        return {
            "schema": "msb.eval/1",
            "pred": str(self.pred),
            "gt": str(self.gt),
            "background": None if self.background is None else list(self.background),
            "count": len(rows),
            "partial": bool(failed),
            "mean": {key: mean_of(row[key] for row in rows) for key in self.metrics},
            "psnr_inf_count": sum(row["psnr"] == math.inf for row in rows),
            "lpips_reason": self.reason,
            "warnings": self.notes,
            "images": [{**row, "psnr": json_safe(row["psnr"])} for row in rows],
            "failed": failed,
            "metrics": [identity.to_dict() for identity in self.measures.identities],
        }

    def print_table(self, rows: list[dict[str, Any]], data: dict[str, Any]) -> None:
        """Print the table of metrics. With --quiet, print the averages only."""
        from msb.metrics.images import PSNR_CAP
        from msb.metrics.vgg import weights_source

        quiet = self.output.quiet
        titles = [metric.title for metric in self.metrics.values()]
        count = f"{len(rows)} of {len(rows) + len(data['failed'])}" if data["failed"] else str(len(rows))
        plural = "" if len(rows) == 1 and not data["failed"] else "s"
        cells: list[tuple[Cell, ...]] = [
            (shorten(row["name"], 200), f"{row['width']}x{row['height']}", *self._format_values(row))
            for row in (() if quiet else rows)
        ]
        cells.append(((f"average of {count} image{plural}", "bold"), "", *self._format_values(data["mean"])))
        self.output.table(("Image", "Size", *titles), cells, right=range(1, 2 + len(titles)))
        if "reason" in data:
            self.output.note(f"warning: {data['reason']}")
        if quiet:
            return
        if data["psnr_inf_count"]:
            number = data["psnr_inf_count"]
            equal = "1 image is equal" if number == 1 else f"{number} images are equal"
            text = f"{equal} to the ground truth; averages use {PSNR_CAP:g} dB for an infinite PSNR"
            self.output.line(text)
        loaded = ", ".join(metric.title for metric in self.metrics.values() if metric.load is not None)
        reason = f"{loaded} --: {self.reason}; " if self.reason else f"{loaded}: "
        identities = self.measures.identities
        used = next((metric.weights for metric in identities if metric.name == "lpips_vgg"), None)
        self.output.console().print(f"{reason}{weights_source(used)}", markup=False)

    def _format_values(self, row: dict[str, Any]) -> list[str]:
        return [
            "--" if row[key] is None else f"{row[key]:.{metric.decimals}f}"
            for key, metric in self.metrics.items()
        ]
