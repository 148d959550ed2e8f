"""The printed form of metric values: title, unit, arrow and number of decimals."""

from decimal import ROUND_HALF_UP, Decimal

from msb.bench.aggregate import METRICS
from msb.topology.metric_text import format_count, format_metric

# For each unit, pairs of a limit for the value and a number of decimals. If a printed value would be below
# the limit, it gets this number of decimals. With the usual decimals, a small value such as 0.04 MiB would be
# printed as 0.
_SMALL_VALUE_DECIMALS = {"MiB": ((0.1, 2), (10.0, 1)), "min": ((1.0, 2),)}
# Metrics that are counts. The mean of counts over several scenes may be a fraction.
_COUNTS = ("components", "faces", "tasks")
# Maximum number of decimals for a printed difference, and for the two values that it compares.
_MOST_DECIMALS = 6
_ARROWS = {"higher": " ↑", "lower": " ↓", None: ""}


def direction_arrow(metric: str) -> str:
    """Return " ↑" if higher values of a metric are better, " ↓" if lower values are better, otherwise ""."""
    return _ARROWS[METRICS[metric].better]


def metric_title(metric: str) -> str:
    """Return the heading of a metric, such as "PSNR ↑"."""
    return METRICS[metric].title + direction_arrow(metric)


def metric_title_with_unit(metric: str) -> str:
    """Return the heading of a metric with its unit, such as "P50 (ms) ↓"."""
    definition = METRICS[metric]
    named = definition.unit in ("ms", "MiB", "mm") and definition.unit not in definition.title
    unit = f" ({definition.unit})" if named else ""
    return f"{definition.title}{unit}{direction_arrow(metric)}"


def to_printed_unit(metric: str, value: float) -> float:
    """Convert `value` from the unit of the records (such as bytes) to the printed unit (such as MiB)."""
    return value / METRICS[metric].scale


def format_digits(value: float, decimals: int, *, sign: bool = False) -> str:
    """Return `value` with `decimals` decimals. If `sign` is true, positive values get a plus sign.

    A printed 0 has no sign.

    Halves are rounded away from zero.

    Examples
    --------
    >>> format_digits(-0.004, 2), format_digits(0.004, 2, sign=True), format_digits(0.006, 2, sign=True)
    ('0.00', '0.00', '+0.01')
    >>> format_digits(2.5, 0), format_digits(0.125, 2)
    ('3', '0.13')
    """
    rounded = Decimal(value).quantize(Decimal(1).scaleb(-decimals), ROUND_HALF_UP)
    printed = f"{rounded:{'+' if sign else ''}.{decimals}f}"
    return printed if rounded else printed.lstrip("+-")


def format_change(change: float, ends: tuple[float, float], decimals: int) -> tuple[str, str, str]:
    """Return a change and its two end values as text.

    Decimals are added until the difference of the printed end values equals the printed change.

    If the difference of the two end values is not equal to the change, they may be means over different
    scenes. In this case, the change and its end values get `decimals` decimals.

    Examples
    --------
    >>> format_change(4.88, (28.16, 23.28), 2), format_change(0.0122, (29.0138, 29.026), 2)
    (('4.88', '28.16', '23.28'), ('0.012', '29.014', '29.026'))
    """
    amount = abs(change)
    belong = abs(amount - abs(ends[0] - ends[1])) < 10.0**-_MOST_DECIMALS

    def texts(digits: int) -> tuple[str, str, str]:
        return format_digits(amount, digits), format_digits(ends[0], digits), format_digits(ends[1], digits)

    for digits in range(decimals, _MOST_DECIMALS + 1 if belong else decimals):
        printed, first, last = map(Decimal, texts(digits))
        if abs(first - last) == printed:
            return texts(digits)
    return texts(decimals)


def choose_decimals(metric: str, printed: float) -> int:
    """Return the number of decimals for `printed`, a value in the printed unit."""
    if metric in _COUNTS and printed < 100 and printed != int(printed):
        return 1
    unit = METRICS[metric].unit
    for limit, decimals in _SMALL_VALUE_DECIMALS.get(unit, ()):
        if 0 < printed < limit:
            return decimals
    return METRICS[metric].decimals


def format_value(metric: str, value: float) -> str:
    """Return `value`, given in the unit of the records, as it is printed in tables.

    Examples
    --------
    >>> format_value("psnr", 28.164), format_value("memory", 1140.1 * 2**20)
    ('28.16', '1140')
    >>> format_value("train_seconds", 1.2), format_value("train_seconds", 90), format_value("memory", 3e5)
    ('0.02', '1.5', '0.3')
    >>> format_value("components", 715_000), format_value("components", 99_999)
    ('0.71 M', '99,999')
    >>> format_value("components", 4.5), format_value("tasks", 6.0)
    ('4.5', '6')
    """
    if metric == "components":
        return format_metric(metric, value)
    if metric in _COUNTS:
        return format_count(value).replace(",", "")
    printed = to_printed_unit(metric, value)
    if METRICS[metric].unit in _SMALL_VALUE_DECIMALS and 0 < printed < 0.01:
        return "<0.01"
    return format_digits(printed, choose_decimals(metric, printed))
