"""Charts as SVG and PDF: gaps and their parts, quality against speed, differences from published results.

The colours are from the palette of Okabe and Ito, so that colour-blind readers can distinguish them. Markers,
line styles and hatches distinguish the same items as the colours. Text and axes have the text colour of the
surrounding page.
"""

from __future__ import annotations

import io
import logging
import math
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import cycle
from typing import TYPE_CHECKING, Any, Literal

from msb.base.extras import need_extra
from msb.bench.aggregate import CONDITION_TITLES, expected_scenes
from msb.bench.records import BAKED
from msb.bench.split import STEPS
from msb.registry import METHODS
from msb.report.compared_views import GROUND_TRUTH
from msb.report.numbers import (
    DRAWN_CONDITIONS,
    MEAN,
    Key,
    Numbers,
    SplitKey,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.safe_names import plain_text, slug
from msb.report.tables.bakes import STEP_TITLES
from msb.report.tables.reproducibility import SOURCES, PublishedPair, list_notes, pair_with_published

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

    from msb.report.compared_views import ComparedView

_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#999999", "#E69F00")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 1)))
_HATCHES = ("", "//", "xx", "..")
_CONDITION_MARKERS = {"non_engine": "*", "dedicated": "s", "standard": "^"}
_VARIANT_MARKERS = ("D", "P", "X", "v")
# Placeholders for the text and page colours, which are replaced when the figure is embedded or saved.
_INK, _PAPER = "#010203", "#fdfcfb"
# Width and height of a chart in inches. The width is about the width of a phone's screen.
_SIZE = (4.6, 3.3)
# Width of a sheet of images in inches (the text width of a paper), and height of row labels in inches.
_SHEET_WIDTH, _LABEL_HEIGHT = 7.0, 0.2
# Number of legend rows that fit without extra space. Each further row makes the chart taller by `_ROW_HEIGHT`
# inches.
_LEGEND_ROWS, _ROW_HEIGHT = 4, 0.19
# Minimum number of bars that a chart has space for. Without a minimum, a single bar would fill the chart.
_MIN_BARS = 3


@dataclass(frozen=True)
class Figure:
    """One chart: `name` is its file name and anchor, and `draw` returns the file in a requested format."""

    name: str
    caption: str
    draw: Callable[[Literal["svg", "pdf"]], bytes] = field(compare=False, repr=False)

    @cached_property
    def svg(self) -> str:
        """The SVG with placeholders for the colours of text and page."""
        # Add a prefix to identifiers, so that figures in one page never share an identifier.
        return re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{self.name}-", self.draw("svg").decode())

    def pdf(self) -> bytes:
        """Return the chart as a PDF for LaTeX, with embedded fonts and without a background."""
        return self.draw("pdf")

    @property
    def inline(self) -> str:
        """The SVG as an element of a page, drawn in the colours of the surrounding text."""
        body = self.svg[self.svg.index("<svg") :]
        return body.replace(_INK, "currentColor").replace(_PAPER, "none")

    @property
    def standalone(self) -> str:
        """The SVG as a file, black on white."""
        return self.svg.replace(_INK, "#1e2024").replace(_PAPER, "#ffffff")


def make_figures(numbers: Numbers, paper: Numbers | None = None) -> list[Figure]:
    """Return the charts of all datasets. Charts without numbers are omitted."""
    charts = []
    for dataset in numbers.datasets():
        charts += [plot_deployment_gap(numbers, dataset), plot_loss_split(numbers, dataset)]
        charts += [plot_quality_speed(numbers, dataset)]
    if paper is not None:
        psnr = [pair for pair in pair_with_published(numbers, paper) if pair.key.metric == "psnr"]
        charts += [plot_differences(psnr, dataset) for dataset in numbers.datasets()]
    return [figure for figure in charts if figure is not None]


def plot_deployment_gap(numbers: Numbers, dataset: str) -> Figure | None:
    """Return the chart of PSNR under Non-Engine, Dedicated and Standard, with a line for each method.

    The result is None if no method has values of two conditions.
    """
    # For each method, collect the points of its line: condition index and PSNR in dB.
    lines = {
        (method, dedicated): points
        for dedicated in ("dedicated", *numbers.variants(dataset, "dedicated"))
        for method in numbers.methods(dataset, "non_engine", dedicated, "standard")
        if (dedicated == "dedicated" or method in numbers.methods(dataset, dedicated))
        and (points := _condition_means(numbers, dataset, method, dedicated))
        and (dedicated == "dedicated" or len(points) > 1)
    }
    if all(len(points) < 2 for points in lines.values()):
        return None

    styles, markers = _choose_styles(numbers), _choose_variant_markers(numbers, dataset)

    def draw(axes: Axes) -> None:
        for (method, dedicated), points in lines.items():
            style = dict(styles[method])
            # The line of a variant has the style of its method, but is thinner and has open markers.
            if name := dedicated.partition("/")[2]:
                style |= {"linewidth": 0.9, "markerfacecolor": "none", "markeredgecolor": style["color"]}
                style |= {"marker": markers[dedicated], "label": f"{style['label']}, {plain_text(name)}"}
            axes.plot(*zip(*points, strict=True), **style)
        axes.set_xticks(
            range(len(DRAWN_CONDITIONS)), [CONDITION_TITLES[condition] for condition in DRAWN_CONDITIONS]
        )
        axes.set_xlim(-0.2, len(DRAWN_CONDITIONS) - 0.8)
        axes.set_ylabel("PSNR (dB), higher is better")
        _draw_legend(axes)

    caption = (
        "PSNR of each method with its native renderer, on the dedicated tier and on the standard tier. A "
        "line ends at the last condition that the method supports. Means are over the scenes that all "
        "conditions of the method have. Thin lines with open markers are variants of Dedicated."
    )
    return _make_figure("deployment_gap", dataset, caption, draw, _list_other_scenes(numbers, dataset))


def _condition_means(numbers: Numbers, dataset: str, method: str, dedicated: str) -> list[tuple[int, float]]:
    """Return pairs of condition index and mean PSNR in dB.

    The means are averages over the scenes that have values of all conditions.

    Two points can be compared only if their means are over the same scenes. The paper prints only means, so
    its numbers are used unchanged.
    """
    through = [dedicated if condition == "dedicated" else condition for condition in DRAWN_CONDITIONS]
    means = [numbers.value(Key(dataset, MEAN, method, condition, "psnr")) for condition in through]
    known = [(place, mean) for place, mean in enumerate(means) if mean is not None]
    if numbers.of_paper:
        return known
    scenes = expected_scenes(dataset, numbers.scenes(dataset))
    values = {
        (place, scene): value
        for place, _ in known
        for scene in scenes
        if (value := numbers.value(Key(dataset, scene, method, through[place], "psnr"))) is not None
    }
    common = [scene for scene in scenes if all((place, scene) in values for place, _ in known)]
    return [
        (place, math.fsum(values[place, scene] for scene in common) / len(common))
        for place, _ in known
        if common
    ]


def plot_loss_split(numbers: Numbers, dataset: str) -> Figure | None:
    """Return the chart of the parts of the loss, or None without bakes.

    The bar of each method extends from the PSNR of Standard to the PSNR of Dedicated. The parts of the bar
    are the losses due to colours, faces and blending.
    """
    # For each method, list the parts of its loss. Each part has a name, and the PSNR in dB at both of its
    # ends.
    bars = {
        method: [(name, *gap.ends) for name, gap in split.steps.items() if gap.ends is not None]
        for method in numbers.methods(dataset)
        if (split := numbers.splits.get(SplitKey(dataset, MEAN, method, "psnr"))) is not None
    }
    bars = {method: parts for method, parts in bars.items() if parts}
    if not bars:
        return None

    def draw(axes: Axes) -> None:
        axes.use_sticky_edges = False
        for place, parts in enumerate(bars.values()):
            for name, better, worse in parts:
                step = STEPS.index(name)
                axes.barh(place, better - worse, 0.5, worse, color=_COLORS[step], hatch=_HATCHES[step],
                          edgecolor=_INK, linewidth=0.6, alpha=0.85, label=STEP_TITLES[name])  # fmt: skip
            # Draw a tick at both ends of every part, because a gain is drawn over the part before it.
            ends = [parts[0][2], *(better for _, better, _ in parts)]
            axes.plot(ends, [place] * len(ends), color=_INK, marker="|", markersize=16, linestyle="none")
        axes.set_yticks(range(len(bars)), [method_title(method) for method in bars])
        middle, half = (len(bars) - 1) / 2, max(len(bars), _MIN_BARS) / 2
        axes.set_ylim(middle + half, middle - half)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("PSNR (dB): from Standard (left) to Dedicated (right)")
        handles, labels = axes.get_legend_handles_labels()
        named = dict(zip(labels, handles, strict=True))
        _draw_legend(axes, [named[title] for title in STEP_TITLES.values() if title in named])

    caption = (
        "parts of the loss from Dedicated to Standard. From left to right: Standard, the same triangles "
        "with the best static colours, the best bake with other triangles, Dedicated. A part that extends to "
        "the left is a gain. A method without Standard starts at the second point."
    )
    return _make_figure("loss_split", dataset, caption, draw, _list_other_scenes(numbers, dataset))


def plot_quality_speed(numbers: Numbers, dataset: str) -> Figure | None:
    """Return the chart of PSNR against frames per second, with a marker for each condition and method.

    The result is None if the chart would have fewer than two points.
    """
    # For each method, list its points in the chart: condition, frames per second and PSNR in dB.
    points: dict[str, list[tuple[str, float, float]]] = {}
    conditions = [
        name for name in numbers.conditions(dataset) if not name.startswith(("standard/", f"{BAKED}/"))
    ]
    for method in numbers.methods(dataset, *conditions):
        for condition in conditions:
            psnr, fps = (
                numbers.value(Key(dataset, MEAN, method, condition, metric)) for metric in ("psnr", "fps")
            )
            if psnr is not None and fps is not None and fps > 0:
                points.setdefault(method, []).append((condition, fps, psnr))
    if sum(map(len, points.values())) < 2:
        return None
    styles, markers = _choose_styles(numbers), _CONDITION_MARKERS | _choose_variant_markers(numbers, dataset)

    def draw(axes: Axes) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

        for method, of_method in points.items():
            style = styles[method]
            _, xs, ys = zip(*of_method, strict=True)
            axes.plot(xs, ys, **{**style, "marker": "", "linewidth": 1})
            for condition, x, y in of_method:
                axes.plot([x], [y], color=style["color"], linestyle="none", markeredgecolor=_INK,
                          markeredgewidth=0.6, marker=markers[condition],
                          markersize=10 if condition == "non_engine" else 7)  # fmt: skip
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("frames per second, logarithmic")
        axes.set_ylabel("PSNR (dB), higher is better")
        # The legend lists methods as lines and conditions as markers.
        handles = [Line2D([], [], **{**styles[method], "marker": ""}) for method in points]
        handles += [
            Line2D([], [], color="none", marker=markers[condition], markerfacecolor=_INK,
                   markeredgecolor=_INK, label=condition_title(condition))
            for condition in conditions
            if any(condition == name for of_method in points.values() for name, _, _ in of_method)
        ]  # fmt: skip
        _draw_legend(axes, handles)

    caption = (
        "quality against speed. Higher is better, further right is faster; markers are conditions, line "
        "styles are methods."
    )
    return _make_figure("quality_speed", dataset, caption, draw, _list_other_scenes(numbers, dataset))


def plot_differences(pairs: Sequence[PublishedPair], dataset: str) -> Figure | None:
    """Return the bar chart of our PSNR minus the published PSNR, or None without published values.

    If values of single scenes are published, the chart has a bar for each scene. If only means are published,
    the chart has one bar for each method.
    """
    of_dataset = [
        pair
        for pair in pairs
        if pair.key.dataset == dataset
        and pair.key.condition == "non_engine"
        and pair.key.source != "meshsplatbench"
    ]
    scenes = [pair for pair in of_dataset if pair.key.scene != MEAN]
    drawn = scenes or of_dataset
    if not drawn:
        return None

    def group_name(pair: PublishedPair) -> str:
        return scene_title(pair.key.scene) if scenes else method_title(pair.key.method)

    def series_name(pair: PublishedPair) -> str:
        source = SOURCES[pair.key.source].lower()
        return f"{method_title(pair.key.method)} - {source}" if scenes else f"this run - {source}"

    groups = list(dict.fromkeys(map(group_name, drawn)))
    series = list(dict.fromkeys(map(series_name, drawn)))

    def draw(axes: Axes) -> None:
        # In a group, the bars are side by side and fill 80 % of the group's width.
        width = 0.8 / len(series)
        for place, name in enumerate(series):
            bars = [pair for pair in drawn if series_name(pair) == name]
            axes.bar(
                [groups.index(group_name(pair)) + (place - (len(series) - 1) / 2) * width for pair in bars],
                [pair.difference for pair in bars],
                width,
                label=name,
                edgecolor=_INK,
                linewidth=0.6,
                color=_COLORS[place % len(_COLORS)],
                hatch=_HATCHES[place % len(_HATCHES)],
            )
        axes.axhline(0, color=_INK, linewidth=0.8)
        # Long labels are rotated, because only 40 characters fit below the axis.
        rotated: dict[str, Any] = {"rotation": 30, "ha": "right"} if sum(map(len, groups)) > 40 else {}
        axes.set_xticks(range(len(groups)), groups, **rotated)
        axes.set_ylabel("PSNR difference (dB)")
        _draw_legend(axes)

    of = "per scene" if scenes else "of the means over scenes"
    caption = " ".join(
        [f"PSNR of this run minus published PSNR, {of}.", *(f"{note}." for note in list_notes(drawn))]
    )
    return _make_figure("reproducibility", dataset, caption, draw)


def _choose_styles(numbers: Numbers) -> dict[str, dict[str, Any]]:
    """Return the line style of each method or model label.

    Methods have different styles, and the style of a method is the same in all charts.

    A built-in method has the same style in every report. Labels, and methods of other packages, get the
    remaining styles.
    """
    models = [method for dataset in numbers.datasets() for method in numbers.methods(dataset)]
    styles = {}
    for place, method in enumerate(dict.fromkeys([*METHODS, *models])):
        # If all colours are used, markers and line styles are shifted, so that no combination repeats.
        round_, color = divmod(place, len(_COLORS))
        styles[method] = {
            "color": _COLORS[color],
            "marker": _MARKERS[(color + round_) % len(_MARKERS)],
            "linestyle": _LINES[(color + 2 * round_) % len(_LINES)],
            "markeredgecolor": _INK,
            "markeredgewidth": 0.6,
            "linewidth": 1.8,
            "label": method_title(method),
        }
    return styles


def _choose_variant_markers(numbers: Numbers, dataset: str) -> dict[str, str]:
    """Return the marker of each variant of the dedicated tier."""
    return dict(zip(numbers.variants(dataset, "dedicated"), cycle(_VARIANT_MARKERS), strict=False))


def _draw_legend(axes: Axes, handles: Sequence[Any] = ()) -> None:
    """Draw a legend below the chart. `handles` are the entries of the legend (default: all).

    A long legend makes the chart taller.
    """
    handles = handles or axes.get_legend_handles_labels()[0]
    figure: Any = axes.figure  # matplotlib's types allow a subfigure, but this object is always a figure
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 2), frameon=False)
    rows = (len(handles) + 1) // 2
    width, height = _SIZE
    figure.set_size_inches(width, height + _ROW_HEIGHT * max(rows - _LEGEND_ROWS, 0))


def _list_other_scenes(numbers: Numbers, dataset: str) -> str:
    """If a dataset has a published name but other scenes, return its first scenes as text."""
    if not numbers.has_other_scenes(dataset):
        return ""
    scenes = list(map(scene_title, numbers.scenes(dataset)))
    return f" ({', '.join([*scenes[:3], *(['...'] if len(scenes) > 3 else [])])})"


def _make_figure(
    kind: str, dataset: str, caption: str, draw: Callable[[Axes], None], scenes: str = ""
) -> Figure:
    title = f"{dataset_title(dataset)}{scenes}"
    return Figure(f"{kind}-{slug(dataset)}", f"{title}: {caption}", partial(_write_chart, title, draw))


def make_sheet(view: ComparedView) -> Figure:
    """Return a sheet for LaTeX that shows a test view.

    Each row shows the photograph and all renderings of one method.
    """
    stem = view.view.rpartition(".")[0] or view.view
    name = "-".join(("qualitative", slug(view.dataset), slug(view.scene), slug(stem)))
    return Figure(name, view.title, partial(_write_sheet, view))


def _write_sheet(view: ComparedView, form: Literal["svg", "pdf"]) -> bytes:
    """Return the bytes of a sheet's file."""
    from PIL import Image

    headings = [GROUND_TRUTH, *view.headings]
    pixels = {
        image.name: Image.open(io.BytesIO(image.data))
        for image in {image.name: image for image in view.images}.values()
    }
    ratio = max((image.height / image.width for image in pixels.values()), default=1.0)
    width = _SHEET_WIDTH / len(headings)

    def lay_out(canvas: Canvas) -> None:
        grid = canvas.subplots(len(view.renderings), len(headings), squeeze=False)
        for axes_row, (method, renderings) in zip(grid, view.renderings.items(), strict=True):
            cells = {rendering.heading: (rendering.image, rendering.psnr) for rendering in renderings}
            cells[GROUND_TRUTH] = (view.ground_truth, None)
            for axes, heading in zip(axes_row, headings, strict=True):
                image, psnr = cells.get(heading, (None, None))
                if image is not None:
                    axes.imshow(pixels[image.name])
                else:
                    tier = heading.partition(",")[0].lower()
                    known = METHODS[method].unsupported if method in METHODS else {}
                    axes.text(0.5, 0.5, "N/A" if tier in known else "--", ha="center", va="center")
                    axes.set_box_aspect(ratio)
                axes.set_xticks([])
                axes.set_yticks([])
                axes.set_xlabel("" if psnr is None else f"{psnr:.2f} dB", fontsize=7, labelpad=1)
            axes_row[0].set_ylabel(method_title(method), fontsize=7)
        for axes, heading in zip(grid[0], headings, strict=True):
            axes.set_title(heading, fontsize=7)

    return _write_canvas(
        form, (_SHEET_WIDTH, (width * ratio + _LABEL_HEIGHT) * len(view.renderings)), lay_out
    )


def _write_chart(title: str, draw: Callable[[Axes], None], form: Literal["svg", "pdf"]) -> bytes:
    """Return the bytes of a chart's file."""

    def lay_out(canvas: Canvas) -> None:
        axes = canvas.add_subplot()
        axes.set_title(title, fontsize=10, fontweight="bold")
        draw(axes)

    return _write_canvas(form, _SIZE, lay_out)


def _write_canvas(
    form: Literal["svg", "pdf"], size: tuple[float, float], lay_out: Callable[[Canvas], None]
) -> bytes:
    """Draw a figure with the function `lay_out`, and return the bytes of the file.

    Equal drawings give equal bytes.
    """
    # hide warnings about a cache that cannot be written
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    need_extra("bench", "matplotlib", what="a figure")
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    # Settings for the colours of text and lines, and for background colours. The settings contain the
    # placeholder colours.
    inked = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color", "grid.color")
    faces = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
    settings = {
        "svg.fonttype": "none",
        "svg.hashsalt": "msb",
        "pdf.fonttype": 42,  # Use TrueType fonts, because publishers reject matplotlib's default, Type 3.
        "text.parse_math": False,  # Scene names can contain dollar signs.
        "font.family": "sans-serif",
        "font.size": 9,
        "axes.grid": True,
        "grid.alpha": 0.15,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "legend.handlelength": 3.2,
        **dict.fromkeys(inked, _INK),
        **dict.fromkeys(faces, _PAPER if form == "svg" else "none"),
    }
    file = io.BytesIO()
    with rc_context(settings), warnings.catch_warnings():
        # Ignore glyphs that matplotlib's font lacks, because browsers draw SVG text with other fonts.
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        canvas = Canvas(figsize=size, layout="constrained")
        lay_out(canvas)
        # If dates and program versions are omitted, equal charts give equal files.
        omitted = {"svg": ("Date", "Creator"), "pdf": ("CreationDate", "Creator", "Producer")}
        canvas.savefig(file, format=form, metadata=dict.fromkeys(omitted[form]))
    return file.getvalue()
