"""How the audit's ratios and counts of components are printed, on the terminal and in reports."""

# Decimals of a ratio or mean, as in the paper's table of mesh diagnostics.
DECIMALS = 2
# Smaller counts are printed in full, because "0.00 M" would say nothing.
_MILLIONS_FROM = 1e5


def structure_text(metric: str, value: float) -> str:
    """Return a number of `msb.topology.audit.Metrics` as tables print it.

    Examples
    --------
    >>> structure_text("vf_ratio", 0.516), structure_text("components", 17)
    ('0.52', '17')
    >>> structure_text("components", 12_345), structure_text("components", 715_000)
    ('12,345', '0.71 M')
    """
    if metric != "components":
        return f"{value:.{DECIMALS}f}"
    return f"{value / 1e6:.{DECIMALS}f} M" if value >= _MILLIONS_FROM else f"{value:,.0f}"
