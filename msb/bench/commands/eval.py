"""`msb eval`: the image metrics of renderings against the ground truth."""

from __future__ import annotations

import math
from collections import Counter
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msb.base.extras import need_extra
from msb.base.option import Argument, Option
from msb.cli.command import Typed, command
from msb.cli.output import Cell, Output, report_error
from msb.errors import EXIT_STATUS, MsbError, about, shorten
from msb.render.options import parsed_color

if TYPE_CHECKING:
    from msb.metrics import ImagePair
    from msb.scenes.colors import Color

NOTHING_SHOWN = "every rendering is of one colour: none shows anything, so there is nothing to compare"
NO_WEIGHTS = "no VGG weights (--vgg-weights FILE)"
_COLUMNS = ("name", "pred", "gt", "width", "height")


@dataclass(frozen=True)
class EvalOptions:
    """How images are compared."""

    vgg_weights: Annotated[
        Path | None,
        Option("torchvision's vgg16-397923af.pth; without it LPIPS is --.", metavar="FILE"),
    ] = None
    background: Annotated[
        str | None,
        Option("What alpha is laid over: black, white, #rrggbb or r,g,b in 0..1.", metavar="COLOR"),
    ] = None
    subset: Annotated[bool, Option("GT may hold more images than PRED.")] = False


@command(
    "msb eval data_stubs/scenes/tanksandtemples/pebble/images/000001.jpg \\\n"
    "      data_stubs/scenes/tanksandtemples/pebble/images/000002.jpg",
    "msb eval --json - data_stubs/scenes/mipnerf360/pebble/images_4 \\\n"
    "      data_stubs/scenes/mipnerf360/pebble/images_4",
    name="eval",
)
def evaluate(
    pred: Annotated[Path, Argument("Folder of images, or one image.", metavar="PRED")],
    gt: Annotated[Path, Argument("The ground truth: the same, with equal names.", metavar="GT")],
    options: EvalOptions,
    output: Annotated[Output, ("json_file", "csv_file", "fail_fast", "force", "quiet", "verbose")],
    typed: Typed,
) -> int:
    """Compare images with their ground truth: PSNR, SSIM, LPIPS, ... of each image, and their means.

    Images are paired by their path below the folder without its suffix (png, jpg, npy, exr). Their sizes must
    be equal; nothing is resized. All images are clamped and rounded to 8 bits. A bad image gets a line on
    standard error and status 3; the others are still compared.
    """
    color = None if options.background is None else parsed_color(options.background)
    from msb.metrics import pair_images

    pairs = pair_images(pred, gt, subset=options.subset)
    return _Task(output, pred, gt, options.vgg_weights, color).run(pairs)


class _Task:
    """Pairs of images, and what is said about them."""

    def __init__(
        self, output: Output, pred: Path, gt: Path, vgg_weights: Path | None, color: Color | None
    ) -> None:
        from msb.metrics import IMAGE_METRICS, Measures

        self.output, self.pred, self.gt, self.background = output, pred, gt, color
        self.reason = NO_WEIGHTS if vgg_weights is None else None
        self.metrics = IMAGE_METRICS
        with nullcontext() if vgg_weights is None else output.progress(f"reading {vgg_weights.name}"):
            self.measures = Measures(vgg_weights)
        self.plain: list[tuple[bool, bool]] = []
        """Whether rendering and ground truth of a pair are each of one colour."""
        self.notes = [one.to_line(vgg_weights) for one in self.measures.warnings]

    def run(self, pairs: list[ImagePair]) -> int:
        """Compare all pairs, print and write; return the exit status."""
        from msb.metrics.registry import modules_needed

        rows: list[dict[str, Any]] = []
        failed: list[dict[str, Any]] = []
        status = 0
        alike: Counter[str] = Counter()
        # Once, not for every pair.
        read = ["OpenEXR"] if any(".exr" in (p.pred.suffix, p.gt.suffix) for p in pairs) else []
        need_extra("bench", *modules_needed(), *read, what="msb eval")
        for note in self.notes:
            self.output.note(note)
        with self.output.counted("comparing", len(pairs)) as step:
            for pair in pairs:
                try:
                    rows.append(self.compare(pair))
                except MsbError as error:
                    # What is wrong with all images alike is said of the first.
                    said = error.code == "METRIC_SIZES_DIFFER" and alike[error.message] > 0
                    status = max(status, EXIT_STATUS[type(error)] if said else report_error(error))
                    alike[error.message] += 1
                    failed.append({"name": pair.name, "code": error.code, "message": str(error)})
                    if self.output.fail_fast:
                        break
                step()
        for failed_metric in self.measures.failed.values():
            self.notes.append(f"warning: {failed_metric}; it has no mean")
            self.output.note(self.notes[-1])
        for message, count in alike.items():
            if count > 1:
                self.output.note(f"{count} of {len(pairs)} fail alike: {message}")
        nothing = bool(rows) and all(a for a, _ in self.plain) and not all(b for _, b in self.plain)
        if nothing:
            rows = [{**row, **dict.fromkeys(self.metrics)} for row in rows]
        data = self.summary(rows, failed) | ({"reason": NOTHING_SHOWN} if nothing else {})
        if self.output.prints_text and rows:
            self.show(rows, data)
        self.output.write_json(data)
        self.output.write_csv((*_COLUMNS, *self.metrics), rows)
        return status

    def compare(self, pair: ImagePair) -> dict[str, Any]:
        """Return the row of one pair."""
        from msb import metrics
        from msb.metrics.images import is_plain

        pred, gt = (metrics.read_image(path, background=self.background) for path in (pair.pred, pair.gt))
        self.plain.append((is_plain(pred), is_plain(gt)))
        with about(pair.pred):
            return {
                "name": pair.name,
                "pred": str(pair.pred),
                "gt": str(pair.gt),
                "width": int(gt.shape[1]),
                "height": int(gt.shape[0]),
                **self.measures(pred, gt),
            }

    def summary(self, rows: list[dict[str, Any]], failed: list[dict[str, Any]]) -> dict[str, Any]:
        """Return the JSON document. A mean is over the images that could be compared."""
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
            "metrics": [each.to_dict() for each in self.measures.identities],
        }

    def show(self, rows: list[dict[str, Any]], data: dict[str, Any]) -> None:
        """Print the table; with --quiet its last line alone."""
        from msb.metrics.images import PSNR_CAP
        from msb.metrics.vgg import weights_source

        quiet = self.output.quiet
        titles = [metric.title for metric in self.metrics.values()]
        of = f"{len(rows)} of {len(rows) + len(data['failed'])}" if data["failed"] else str(len(rows))
        plural = "" if len(rows) == 1 and not data["failed"] else "s"
        cells: list[tuple[Cell, ...]] = [
            (shorten(row["name"], 200), f"{row['width']}x{row['height']}", *self._cells(row))
            for row in (() if quiet else rows)
        ]
        cells.append(((f"mean of {of} image{plural}", "bold"), "", *self._cells(data["mean"])))
        self.output.table(("Image", "Size", *titles), cells, right=range(1, 2 + len(titles)))
        if "reason" in data:
            self.output.note(f"warning: {data['reason']}")
        if quiet:
            return
        if data["psnr_inf_count"]:
            equal = f"{data['psnr_inf_count']} equal to the ground truth"
            self.output.line(f"{equal}: inf counts {PSNR_CAP:g} dB in the mean")
        without = ", ".join(metric.title for metric in self.metrics.values() if metric.load is not None)
        reason = f"{without} --: {self.reason}; " if self.reason else f"{without}: "
        used = next((one.weights for one in self.measures.identities if one.name == "lpips_vgg"), None)
        self.output.console().print(f"{reason}{weights_source(used)}", markup=False)

    def _cells(self, row: dict[str, Any]) -> list[str]:
        return [
            "--" if row[key] is None else f"{row[key]:.{metric.decimals}f}"
            for key, metric in self.metrics.items()
        ]
