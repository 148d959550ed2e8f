"""How each metric is printed: its title, unit, arrow and number of decimals."""

from msb.bench.aggregate import METRICS
from msb.topology.shown import structure_text

# Unit -> below which value how many decimals are printed, because "0" would say that there is nothing.
_SMALL = {"MiB": ((0.1, 2), (10.0, 1)), "min": ((1.0, 2),)}
_ARROWS = {"higher": " ↑", "lower": " ↓", None: ""}


def arrow(metric: str) -> str:
    """Return " ↑" where higher is better, " ↓" where lower is, "" where neither."""
    return _ARROWS[METRICS[metric].better]


def title(metric: str) -> str:
    """Return the heading of a column or row of `metric`."""
    return METRICS[metric].title + arrow(metric)


def title_with_unit(metric: str) -> str:
    """Return the heading of `metric` where nothing around it says the unit."""
    shown = METRICS[metric]
    unit = f" ({shown.unit})" if shown.unit in ("ms", "MiB", "mm") and shown.unit not in shown.title else ""
    return f"{shown.title}{unit}{arrow(metric)}"


def printed_value(metric: str, value: float) -> float:
    """Return `value`, in the records' unit, in the unit it is printed in."""
    return value / METRICS[metric].scale


def digits(value: float, decimals: int, *, sign: bool = False) -> str:
    """Return `value` with so many decimals; what rounds to 0 has no sign.

    Examples
    --------
    >>> digits(-0.004, 2), digits(0.004, 2, sign=True), digits(0.006, 2, sign=True)
    ('0.00', '0.00', '+0.01')
    """
    shown = f"{value:{'+' if sign else ''}.{decimals}f}"
    return shown if float(shown) else shown.lstrip("+-")


def decimals(metric: str, shown: float) -> int:
    """Return how many decimals of `shown`, in the unit it is printed in, are printed."""
    unit = METRICS[metric].unit
    return next((more for below, more in _SMALL.get(unit, ()) if 0 < shown < below), METRICS[metric].decimals)


def text(metric: str, value: float) -> str:
    """Return `value`, in the records' unit, as a table prints it.

    Examples
    --------
    >>> text("psnr", 28.164), text("memory", 1140.1 * 2**20)
    ('28.16', '1140')
    >>> text("train_seconds", 1.2), text("train_seconds", 90), text("memory", 300_000)
    ('0.02', '1.5', '0.3')
    >>> text("components", 715_000), text("components", 17)
    ('0.71 M', '17')
    """
    if metric == "components":
        return structure_text(metric, value)
    shown = printed_value(metric, value)
    if METRICS[metric].unit in _SMALL and 0 < shown < 0.01:
        return "<0.01"
    return digits(shown, decimals(metric, shown))
