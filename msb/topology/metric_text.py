"""Text of ratios and component counts of an audit, as the terminal and reports print them."""

# Decimals of ratios and averages, as in the table of mesh diagnostics of the paper.
DECIMALS = 2
# Counts from here on are printed in millions; smaller ones in full, because "0.00 M" says nothing.
_MILLIONS_FROM = 1e5


def format_metric(metric: str, value: float) -> str:
    """Return the value of a metric of `msb.topology.audit.Metrics` as tables print it.

    Examples
    --------
    >>> format_metric("vf_ratio", 0.516), format_metric("components", 17)
    ('0.52', '17')
    >>> format_metric("components", 12_345), format_metric("components", 715_000)
    ('12,345', '0.71 M')
    """
    if metric != "components":
        return f"{value:.{DECIMALS}f}"
    return f"{value / 1e6:.{DECIMALS}f} M" if value >= _MILLIONS_FROM else f"{value:,.0f}"
