"""How each metric is printed: its title, unit, arrow and number of decimals."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

from msb.base.packages import Lazy
from msb.bench.aggregate import METRICS
from msb.metrics.registry import IMAGE_METRICS
from msb.topology.shown import DECIMALS, structure_text

_MIB = float(1 << 20)
_SMALL_MIB = 10.0
"""Memory of fewer MiB is printed with decimals, because "0" would say that there is none."""


class Shown(NamedTuple):
    """How a metric of `msb.bench.aggregate.METRICS` is printed. `scale`: a printed unit in records' units."""

    title: str
    unit: str
    decimals: int
    scale: float = 1.0

    @property
    def last_digit(self) -> float:
        """What the last printed digit stands for, in the records' unit: no difference below it is shown."""
        return float(10.0**-self.decimals * self.scale)


_OTHERS: dict[str, Shown] = {
    "fps": Shown("FPS", "1/s", 0),
    "p50_ms": Shown("P50", "ms", 1),
    "p95_ms": Shown("P95", "ms", 1),
    "spread_ms": Shown("P95 - P50", "ms", 1),
    "busy_p50_ms": Shown("Busy P50", "ms", 1),
    "host_ms": Shown("Host", "ms", 1),
    "unsteady": Shown("Rounds apart (%)", "%", 0, 0.01),
    "memory": Shown("Memory", "MiB", 0, _MIB),
    "driver_memory": Shown("By the driver", "MiB", 0, _MIB),
    "asset_size": Shown("Asset", "MiB", 0, _MIB),
    "train_memory": Shown("Peak mem. (MiB)", "MiB", 0, _MIB),
    "train_seconds": Shown("Train time (min)", "min", 1, 60.0),
    "chamfer": Shown("CD", "mm", 2),
    "vf_ratio": Shown("V/F", "1", DECIMALS),
    "mean_valence": Shown("Valence", "1", DECIMALS),
    "boundary_edge_ratio": Shown("Boundary edge", "1", DECIMALS),
    "nonmanifold_edge_ratio": Shown("Non-manif. edge", "1", DECIMALS),
    "nonmanifold_vertex_ratio": Shown("Non-manif. vertex", "1", DECIMALS),
    "lcc_face_ratio": Shown("LCC face", "1", DECIMALS),
    "lcc_area_ratio": Shown("LCC area", "1", DECIMALS),
    "components": Shown("Components", "1", DECIMALS),
}


@cache
def _shown() -> Mapping[str, Shown]:
    images = {key: Shown(each.title, each.unit, each.decimals) for key, each in IMAGE_METRICS.items()}
    return images | _OTHERS


SHOWN: Mapping[str, Shown] = Lazy(_shown)
_ARROWS = {"higher": " ↑", "lower": " ↓", None: ""}


def arrow(metric: str) -> str:
    """Return " ↑" where higher is better, " ↓" where lower is, "" where neither."""
    return _ARROWS[METRICS[metric].better]


def title(metric: str) -> str:
    """Return the heading of a column or row of `metric`."""
    return SHOWN[metric].title + arrow(metric)


def title_with_unit(metric: str) -> str:
    """Return the heading of `metric` where nothing around it says the unit."""
    shown = SHOWN[metric]
    unit = f" ({shown.unit})" if shown.unit in ("ms", "MiB", "mm") and shown.unit not in shown.title else ""
    return f"{shown.title}{unit}{arrow(metric)}"


def printed_value(metric: str, value: float) -> float:
    """Return `value`, in the records' unit, in the unit it is printed in."""
    return value / SHOWN[metric].scale


def digits(value: float, decimals: int, *, sign: bool = False) -> str:
    """Return `value` with so many decimals; what rounds to 0 has no sign.

    Examples
    --------
    >>> digits(-0.004, 2), digits(0.004, 2, sign=True), digits(0.006, 2, sign=True)
    ('0.00', '0.00', '+0.01')
    """
    shown = f"{value:{'+' if sign else ''}.{decimals}f}"
    return shown if float(shown) else shown.lstrip("+-")


def text(metric: str, value: float) -> str:
    """Return `value`, in the records' unit, as a table prints it.

    Examples
    --------
    >>> text("psnr", 28.164), text("memory", 1140.1 * 2**20)
    ('28.16', '1140')
    >>> text("components", 715_000), text("components", 17)
    ('0.71 M', '17')
    """
    if metric == "components":
        return structure_text(metric, value)
    shown = printed_value(metric, value)
    if SHOWN[metric].unit == "MiB" and 0 < shown < _SMALL_MIB:
        return f"{shown:.1f}" if shown >= 0.1 else f"{shown:.2f}" if shown >= 0.01 else "<0.01"
    return digits(shown, SHOWN[metric].decimals)
