"""Options of `msb score`, and the conditions of --fail-on."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msb.base.option import Option
from msb.errors import GateFailed, UsageError, shorten

_SIGNS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_PATTERN = re.compile(r"\s*([a-z_]+)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*")
# Key of a condition -> where its value is in the JSON document.
KEYS: dict[str, tuple[str, ...]] = {
    **{
        key: ("looks", key) for key in ("psnr", "psnr_covered", "psnr_mask", "psnr_exposure", "ssim", "lpips")
    },
    "covered_share": ("views", "covered_share"),
    "mask_share": ("views", "mask_share"),
    "residual": ("pose", "residual"),
    "scale": ("pose", "scale"),
    "faces": ("structure", "faces"),
    "bytes": ("structure", "bytes"),
    "parallax": ("evidence", "parallax"),
    "single_view": ("evidence", "single_view"),
    "shimmer": ("walk", "shimmer"),
    "popping": ("walk", "popping"),
    "flags": ("flags",),
}


@dataclass(frozen=True)
class ScoreOptions:
    """How an asset is scored."""

    capture: Annotated[
        Path | None,
        Option("The photographs: a scene as msb scenes lists it, or msb capture writes it.", metavar="SCENE"),
    ] = None
    pose: Annotated[
        str,
        Option(
            "found: find the asset in the photographs. capture: the asset is in the frame of the capture. "
            "FILE: JSON with a 4 x 4 matrix from the asset to the capture, or an earlier score.",
            metavar="found|capture|FILE",
        ),
    ] = "found"
    out: Annotated[
        Path | None,
        Option(
            "Write the certificate into FOLDER: index.html and score.json.",
            ("--out", "-o"),
            metavar="FOLDER",
            output="own",
        ),
    ] = None
    walk: Annotated[
        int,
        Option(
            "Measure shimmer and popping on a walk of this many frames, such as 240.", least=0, most=10_000
        ),
    ] = 0
    trial: Annotated[
        tuple[str, ...],
        Option("Also try this task of msb trial, such as collision. May be repeated.", metavar="TASK"),
    ] = ()
    supersample: Annotated[
        int,
        Option("Samples along each side of a pixel. msb run takes 1.", least=1, most=16),
    ] = 4
    background: Annotated[
        str,
        Option(
            "Colour behind the asset and outside masks: black, white, #rrggbb or r,g,b in 0..1. msb run uses "
            "that of the dataset, or black.",
            metavar="COLOR",
        ),
    ] = "0.5,0.5,0.5"
    vgg_weights: Annotated[
        Path | None,
        Option("Weights for LPIPS: vgg16-397923af.pth of torchvision.", metavar="FILE"),
    ] = None
    fail_on: Annotated[
        tuple[str, ...],
        Option('Fail if this is true, e.g. "psnr<24" or "flags>0". May be given again.', metavar="COND"),
    ] = ()


@dataclass(frozen=True)
class Condition:
    """A condition of --fail-on on a key of `KEYS`."""

    key: str
    sign: str
    limit: float

    def check(self, document: dict[str, Any]) -> GateFailed | None:
        """Return the error if the condition is true, or if its value is missing from a scored document."""
        value: Any = document
        for key in KEYS[self.key]:
            value = None if value is None else value[key]
        value = len(value) if isinstance(value, list) else value
        if value is not None and not _SIGNS[self.sign](value, self.limit):
            return None
        text = "is not measured" if value is None else f"is {value:g}"
        condition = f"{self.key} {self.sign} {self.limit:g}"
        return GateFailed("GATE_FAILED", f"{self.key} {text}, gate: {condition}", file=document["path"])


def parse_condition(text: str) -> Condition:
    """Return the condition written as ``KEY OPERATOR NUMBER``, such as "psnr<24"."""
    match = _PATTERN.fullmatch(text)
    if not match or match[1] not in KEYS:
        raise UsageError(
            "USAGE", f'--fail-on "{shorten(text)}" is not KEY OPERATOR NUMBER; keys are {", ".join(KEYS)}'
        )
    try:
        limit = float(match[3])
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise UsageError("USAGE", f'--fail-on: "{shorten(match[3])}" is not a finite number')
    return Condition(match[1], match[2], limit)
