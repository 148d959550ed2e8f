"""Text of ratios and component counts of an audit, for the terminal and for reports."""

import math

# Number of decimals of ratios and averages, as in the paper's table of mesh diagnostics.
DECIMALS = 2
# Larger counts are printed in millions. Smaller counts are printed in full, because "0.00 M" is useless.
_MILLIONS_FROM = 1e5
# Averages below this limit are printed with one decimal if they are not whole numbers.
_FRACTIONS_BELOW = 100


def format_metric(metric: str, value: float) -> str:
    """Return a metric of `msb.topology.audit.Metrics` as text for tables.

    Examples
    --------
    >>> format_metric("vf_ratio", 0.516), format_metric("components", 17)
    ('0.52', '17')
    >>> format_metric("components", 12_345), format_metric("components", 715_000)
    ('12,345', '0.71 M')
    """
    if metric != "components":
        return f"{value:.{DECIMALS}f}"
    return f"{value / 1e6:.{DECIMALS}f} M" if value >= _MILLIONS_FROM else format_count(value)


def format_count(value: float) -> str:
    """Return the text of a count, or of a mean of counts. Halves are rounded up.

    Examples
    --------
    >>> format_count(4.0), format_count(4.5), format_count(1234.5)
    ('4', '4.5', '1,235')
    """
    if value < _FRACTIONS_BELOW and value != int(value):
        return f"{math.floor(10 * value + 0.5) / 10:.1f}"
    return f"{math.floor(value + 0.5):,}"
