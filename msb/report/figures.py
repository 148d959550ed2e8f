"""The charts as SVG and PDF: gaps between conditions and their parts, quality against speed, differences from
the published.

Colours are Okabe and Ito's, which the colour-blind can tell apart; markers, line styles and hatches say the
same without them. Text and axes take the colour of the page they stand in.
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
from msb.report.tables.reproducibility import SOURCES, Pair, pairs

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#999999", "#E69F00")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 1)))
_HATCHES = ("", "//", "xx", "..")
_CONDITION_MARKERS = {"non_engine": "*", "dedicated": "s", "standard": "^"}
_VARIANT_MARKERS = ("D", "P", "X", "v")
# Placeholders of the colours of text and page, which depend on where the figure is shown.
_INK, _PAPER = "#010203", "#fdfcfb"
# Width and height of a chart in inches; a phone shows it about this wide.
_SIZE = (4.6, 3.3)
# Rows of a legend for which the height leaves room, and the inches that each further one adds.
_ROWS, _ROW = 4, 0.19
# A chart of fewer bars leaves room for so many: one bar would fill it.
_FEWEST_BARS = 3


@dataclass(frozen=True)
class Figure:
    """One chart, drawn when it is asked for: `drawn` returns the file of a format.

    `name` names its file and anchor; `caption` says in words what it shows.
    """

    name: str
    caption: str
    drawn: Callable[[Literal["svg", "pdf"]], bytes] = field(compare=False, repr=False)

    @cached_property
    def svg(self) -> str:
        """The SVG, with placeholders for the colours of text and page."""
        # Identifiers would clash with those of the next figure in the same page.
        return re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{self.name}-", self.drawn("svg").decode())

    def pdf(self) -> bytes:
        """Return the chart as a PDF for LaTeX, with the fonts it needs and without a background."""
        return self.drawn("pdf")

    @property
    def inline(self) -> str:
        """The SVG as an element of a page, in the colours of the text around it."""
        body = self.svg[self.svg.index("<svg") :]
        return body.replace(_INK, "currentColor").replace(_PAPER, "none")

    @property
    def alone(self) -> str:
        """The SVG as a file, black on white."""
        return self.svg.replace(_INK, "#1e2024").replace(_PAPER, "#ffffff")


def figures(numbers: Numbers, paper: Numbers | None = None) -> list[Figure]:
    """Return every chart there are numbers for."""
    charts = []
    for dataset in numbers.datasets():
        charts += [deployment_gap(numbers, dataset), loss_split(numbers, dataset)]
        charts += [quality_speed(numbers, dataset)]
    if paper is not None:
        own = [pair for pair in pairs(numbers, paper) if pair.key.metric == "psnr"]
        charts += [differences(own, dataset) for dataset in numbers.datasets()]
    return [figure for figure in charts if figure is not None]


def deployment_gap(numbers: Numbers, dataset: str) -> Figure | None:
    """Return PSNR from Non-Engine to Dedicated to Standard, a line per method; None without two points."""
    lines = {
        (method, dedicated): points
        for dedicated in ("dedicated", *numbers.in_place_of(dataset, "dedicated"))
        for method in numbers.methods(dataset, "non_engine", dedicated, "standard")
        if (dedicated == "dedicated" or method in numbers.methods(dataset, dedicated))
        and (points := _condition_means(numbers, dataset, method, dedicated))
        and (dedicated == "dedicated" or len(points) > 1)
    }
    if all(len(points) < 2 for points in lines.values()):
        return None

    styles, markers = _styles(numbers), _variant_markers(numbers, dataset)

    def draw(axes: Axes) -> None:
        for (method, dedicated), points in lines.items():
            style = dict(styles[method])
            if name := dedicated.partition("/")[2]:  # a variant: the method's line, thin and open
                style |= {"linewidth": 0.9, "markerfacecolor": "none", "markeredgecolor": style["color"]}
                style |= {"marker": markers[dedicated], "label": f"{style['label']}, {plain_text(name)}"}
            axes.plot(*zip(*points, strict=True), **style)
        axes.set_xticks(
            range(len(DRAWN_CONDITIONS)), [CONDITION_TITLES[condition] for condition in DRAWN_CONDITIONS]
        )
        axes.set_xlim(-0.2, len(DRAWN_CONDITIONS) - 0.8)
        axes.set_ylabel("PSNR (dB), higher is better")
        _legend(axes)

    caption = (
        "PSNR of each method with its own renderer, dedicated and standard. A line stops at the last "
        "condition that supports the method; its means are over the scenes that all of its conditions have. "
        "A thin line with open markers goes through a variant of Dedicated."
    )
    return _figure("deployment_gap", dataset, caption, draw, _other_scenes(numbers, dataset))


def _condition_means(numbers: Numbers, dataset: str, method: str, dedicated: str) -> list[tuple[int, float]]:
    """Return place of a condition -> mean PSNR, over the scenes that all conditions of the method have.

    The slope of a line is a gap, which two means over other scenes would not show. The paper has means only.
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


def loss_split(numbers: Numbers, dataset: str) -> Figure | None:
    """Return a bar per method from Standard's PSNR to Dedicated's, in its parts; None without bakes."""
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
                which = STEPS.index(name)
                axes.barh(place, better - worse, 0.5, worse, color=_COLORS[which], hatch=_HATCHES[which],
                          edgecolor=_INK, linewidth=0.6, alpha=0.85, label=STEP_TITLES[name])  # fmt: skip
            ends = [parts[0][2], *(better for _, better, _ in parts)]
            axes.plot(ends, [place] * len(ends), color=_INK, marker="|", markersize=16, linestyle="none")
        axes.set_yticks(range(len(bars)), [method_title(method) for method in bars])
        middle, half = (len(bars) - 1) / 2, max(len(bars), _FEWEST_BARS) / 2
        axes.set_ylim(middle + half, middle - half)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("PSNR (dB): from Standard (left) to Dedicated (right)")
        handles, labels = axes.get_legend_handles_labels()
        named = dict(zip(labels, handles, strict=True))
        _legend(axes, [named[title] for title in STEP_TITLES.values() if title in named])

    caption = (
        "what the loss from Dedicated to Standard is made of. From the left: Standard, the same triangles in "
        "the best static colours, the best bake of other triangles, Dedicated. A part that runs to the left "
        "is a gain; a method without Standard begins at the second."
    )
    return _figure("loss_split", dataset, caption, draw, _other_scenes(numbers, dataset))


def quality_speed(numbers: Numbers, dataset: str) -> Figure | None:
    """Return PSNR against frames per second, a marker per condition and method; None without two points."""
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
    styles, markers = _styles(numbers), _CONDITION_MARKERS | _variant_markers(numbers, dataset)

    def draw(axes: Axes) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

        for method, own in points.items():
            style = styles[method]
            _, xs, ys = zip(*own, strict=True)
            axes.plot(xs, ys, **{**style, "marker": "", "linewidth": 1})
            for condition, x, y in own:
                axes.plot([x], [y], color=style["color"], linestyle="none", markeredgecolor=_INK,
                          markeredgewidth=0.6, marker=markers[condition],
                          markersize=10 if condition == "non_engine" else 7)  # fmt: skip
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("frames per second, logarithmic")
        axes.set_ylabel("PSNR (dB), higher is better")
        handles = [Line2D([], [], **{**styles[method], "marker": ""}) for method in points]
        handles += [
            Line2D([], [], color="none", marker=markers[condition], markerfacecolor=_INK,
                   markeredgecolor=_INK, label=condition_title(condition))
            for condition in conditions
            if any(condition == one for own in points.values() for one, _, _ in own)
        ]  # fmt: skip
        _legend(axes, handles)

    caption = (
        "quality against speed. Up is better, right is faster; the markers are the conditions, the line "
        "styles the methods."
    )
    return _figure("quality_speed", dataset, caption, draw, _other_scenes(numbers, dataset))


def differences(published: Sequence[Pair], dataset: str) -> Figure | None:
    """Return bars of ours - published PSNR, of scenes where those are published, else of the means."""
    own = [
        pair
        for pair in published
        if pair.key.dataset == dataset
        and pair.key.condition == "non_engine"
        and pair.key.source != "meshsplatbench"
    ]
    scenes = [pair for pair in own if pair.key.scene != MEAN]
    own = scenes or own
    if not own:
        return None

    def name(pair: Pair) -> str:
        return scene_title(pair.key.scene) if scenes else method_title(pair.key.method)

    def series(pair: Pair) -> str:
        source = SOURCES[pair.key.source].lower()
        return f"{method_title(pair.key.method)} - {source}" if scenes else f"this run - {source}"

    groups = list(dict.fromkeys(map(name, own)))
    kinds = list(dict.fromkeys(map(series, own)))

    def draw(axes: Axes) -> None:
        width = 0.8 / len(kinds)
        for place, kind in enumerate(kinds):
            bars = [pair for pair in own if series(pair) == kind]
            axes.bar(
                [groups.index(name(pair)) + (place - (len(kinds) - 1) / 2) * width for pair in bars],
                [pair.difference for pair in bars],
                width,
                label=kind,
                edgecolor=_INK,
                linewidth=0.6,
                color=_COLORS[place % len(_COLORS)],
                hatch=_HATCHES[place % len(_HATCHES)],
            )
        axes.axhline(0, color=_INK, linewidth=0.8)
        turned: dict[str, Any] = {"rotation": 30, "ha": "right"} if sum(map(len, groups)) > 40 else {}
        axes.set_xticks(range(len(groups)), groups, **turned)
        axes.set_ylabel("PSNR difference (dB)")
        _legend(axes)

    of = "per scene" if scenes else "of the means over scenes"
    return _figure("reproducibility", dataset, f"PSNR of this run minus published PSNR, {of}.", draw)


def _styles(numbers: Numbers) -> dict[str, dict[str, Any]]:
    """Return model -> what its lines look like, the same in every chart; no two models look alike.

    A method of ours looks as in every report; labels and methods of other packages take the places after it.
    """
    models = [method for dataset in numbers.datasets() for method in numbers.methods(dataset)]
    styles = {}
    for place, method in enumerate(dict.fromkeys([*METHODS, *models])):
        again, own = divmod(place, len(_COLORS))
        styles[method] = {
            "color": _COLORS[own],
            "marker": _MARKERS[(own + again) % len(_MARKERS)],
            "linestyle": _LINES[(own + 2 * again) % len(_LINES)],
            "markeredgecolor": _INK,
            "markeredgewidth": 0.6,
            "linewidth": 1.8,
            "label": method_title(method),
        }
    return styles


def _variant_markers(numbers: Numbers, dataset: str) -> dict[str, str]:
    """Return the marker of each variant of the dedicated tier."""
    return dict(zip(numbers.in_place_of(dataset, "dedicated"), cycle(_VARIANT_MARKERS), strict=False))


def _legend(axes: Axes, handles: Sequence[Any] = ()) -> None:
    """Write a legend of `handles`, or of all that is drawn, below the chart; a long one makes it taller."""
    handles = handles or axes.get_legend_handles_labels()[0]
    figure: Any = axes.figure  # a whole one, for which matplotlib's types do not vouch
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 2), frameon=False)
    rows = (len(handles) + 1) // 2
    width, height = _SIZE
    figure.set_size_inches(width, height + _ROW * max(rows - _ROWS, 0))


def _other_scenes(numbers: Numbers, dataset: str) -> str:
    """Return which scenes go by the name of a published dataset that has none of them."""
    scenes = list(map(scene_title, numbers.scenes(dataset)))
    shown = ", ".join([*scenes[:3], *(["..."] if len(scenes) > 3 else [])])
    return f" ({shown})" if numbers.has_other_scenes(dataset) else ""


def _figure(kind: str, dataset: str, caption: str, draw: Callable[[Axes], None], scenes: str = "") -> Figure:
    title = f"{dataset_title(dataset)}{scenes}"
    return Figure(f"{kind}-{slug(dataset)}", f"{title}: {caption}", partial(_drawn, title, draw))


def _drawn(title: str, draw: Callable[[Axes], None], form: Literal["svg", "pdf"]) -> bytes:
    """Return a chart as a file; the same numbers give the same bytes."""
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # a cache it cannot write is no news to a user
    need_extra("bench", "matplotlib", what="a figure")
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    inked = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color", "grid.color")
    faces = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
    settings = {
        "svg.fonttype": "none",
        "svg.hashsalt": "msb",
        "pdf.fonttype": 42,  # TrueType: publishers refuse the default, Type 3
        "text.parse_math": False,  # a dollar sign in a scene's name is one
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
        # A browser has glyphs that the font used for measuring has not.
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        canvas = Canvas(figsize=_SIZE, layout="constrained")
        axes = canvas.add_subplot()
        axes.set_title(title, fontsize=10, fontweight="bold")
        draw(axes)
        unnamed = {"svg": ("Date", "Creator"), "pdf": ("CreationDate", "Creator", "Producer")}
        canvas.savefig(file, format=form, metadata=dict.fromkeys(unnamed[form]))
    return file.getvalue()
