"""The findings: what the numbers say in sentences, each with its numbers and the table they stand in."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

from msb.bench.gaps import PAIRS
from msb.report.metric_format import SHOWN, text
from msb.report.numbers import DRAWN_CONDITIONS, MEAN, Key, condition_title, dataset_title, method_title
from msb.report.safe_names import slug
from msb.report.table import NOT_SUPPORTED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from msb.bench.gaps import GapName
    from msb.report.numbers import Numbers

_NOTHING = 0.005
"""A difference of less than this many dB is printed as 0.00."""
_GAPS: dict[GapName, str] = {"adapt": "adaptation", "port": "portability", "deploy": "deployment"}


@dataclass(frozen=True)
class Finding:
    """One sentence. `table` labels the table of its numbers; `kind` says what it is about."""

    kind: str
    sentence: str
    table: str

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data."""
        return {"kind": self.kind, "sentence": self.sentence, "table": self.table}


class _Case(NamedTuple):
    value: float
    dataset: str
    method: str
    detail: str

    @property
    def name(self) -> str:
        return f"{method_title(self.method)} on {dataset_title(self.dataset)}"


def find(numbers: Numbers) -> list[Finding]:
    """Return the findings, most important first. Where there are no numbers there are no findings."""
    return [
        *_gap_findings(numbers),
        *_monotone_findings(numbers),
        *_ranking_findings(numbers),
        *_speed_findings(numbers),
        *_structure_findings(numbers),
        *_unsupported_findings(numbers),
    ]


def _gap_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the largest and the smallest of each gap in PSNR."""
    for name, word in _GAPS.items():
        cases = list(_gap_cases(numbers, name))
        if not cases:
            continue
        first, last = max(cases), min(cases)
        start, end = (condition_title(condition) for condition in PAIRS[name])
        if max(abs(case.value) for case in cases) < _NOTHING:
            who = first.name if len(cases) == 1 else f"any of the {len(cases)} cases"
            sentence = f"{start} to {end} changes the PSNR of {who} by less than {_NOTHING} dB."
            yield Finding(f"{name}_gap", sentence, f"gaps-{slug(first.dataset)}")
            continue
        sentence = f"{start} to {end} costs {first.name} {first.detail}"
        if first.value < 0:
            sentence = f"{start} to {end} loses nothing: {first.name} {first.detail}"
        if len(cases) > 1:
            sentence += (
                f", the largest {word} gap of {len(cases)}; the smallest is {last.detail}, of {last.name}"
            )
        yield Finding(f"{name}_gap", f"{sentence}.", f"gaps-{slug(first.dataset)}")


def _gap_cases(numbers: Numbers, name: GapName) -> Iterator[_Case]:
    for key, gaps in numbers.gaps.items():
        gap = gaps[name]
        if (key.scene, key.metric, key.standard) != (MEAN, "psnr", "standard"):
            continue
        if gap.signed is None or gap.ends is None:
            continue
        values = " to ".join(f"{value:.2f}" for value in gap.ends)
        partial = f", over {gap.scenes} of {gap.expected} scenes" if gap.partial else ""
        gain = "a gain, " if gap.signed < 0 else ""
        detail = f"{gap.signed:.2f} dB ({gain}{values}{partial})"
        yield _Case(gap.signed, key.dataset, key.method, detail)


def _monotone_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the cases in which Dedicated does not lie between the other two."""
    means = [
        (key, gaps) for key, gaps in numbers.gaps.items() if (key.scene, key.standard) == (MEAN, "standard")
    ]
    known = [(key, gaps) for key, gaps in means if gaps.monotone is not None]
    broken = [(key, gaps) for key, gaps in known if gaps.monotone is False]
    if not known:
        return
    if not broken:
        sentence = (
            f"In all {len(known)} cases in which the three conditions can be compared, Dedicated lies "
            "between Non-Engine and Standard: the adaptation and portability gaps add up to the deployment "
            "gap."
        )
        yield Finding("monotone", sentence, f"gaps-{slug(known[0][0].dataset)}")
    for key, gaps in broken:
        better = (
            "Dedicated is better than Non-Engine"
            if (gaps.adapt.signed or 0) < 0
            else "Standard beats Dedicated"
        )
        signs = ", ".join(f"{name} {text_of(key.metric, gaps[name].signed)}" for name in _GAPS)
        sentence = (
            f"{method_title(key.method)} on {dataset_title(key.dataset)} is not monotone in "
            f"{SHOWN[key.metric].title}: {better} (losses: {signs}), so adapt + port exceeds deploy by "
            f"{text(key.metric, gaps.triangle_excess or 0.0)}."
        )
        yield Finding("not_monotone", sentence, f"gaps-{slug(key.dataset)}")


def text_of(metric: str, value: float | None) -> str:
    """Return a signed loss as printed."""
    return "--" if value is None else f"{'+' if value >= 0 else '-'}{text(metric, abs(value))}"


def _ranking_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield where the order of the methods by PSNR changes from one condition to another."""
    for dataset in numbers.datasets():
        same = []
        conditions = [condition for condition in DRAWN_CONDITIONS if condition in numbers.conditions(dataset)]
        for first, second in combinations(conditions, 2):
            before, after = (
                _ranking(numbers, dataset, first, second),
                _ranking(numbers, dataset, second, first),
            )
            if len(before) < 2:
                continue
            names = f"{condition_title(first)} and {condition_title(second)}"
            label = f"renderer_comparison-{slug(dataset)}"
            if [method for method, _ in before] == [method for method, _ in after]:
                same.append(names)
                continue
            sentence = (
                f"On {dataset_title(dataset)} the ranking by PSNR changes between {names}: "
                f"{_order(before)} becomes {_order(after)}."
            )
            yield Finding("ranking", sentence, label)
        if same:
            pairs = " and under ".join(same)
            sentence = f"On {dataset_title(dataset)} the ranking by PSNR is the same under {pairs}."
            yield Finding("same_ranking", sentence, f"renderer_comparison-{slug(dataset)}")


def _ranking(numbers: Numbers, dataset: str, condition: str, other: str) -> list[tuple[str, float]]:
    """Return the methods that have whole means in both conditions, best in `condition` first."""
    found = []
    for method in numbers.methods(dataset, condition):
        both = [numbers.number(Key(dataset, MEAN, method, c, "psnr")) for c in (condition, other)]
        if both[0].value is not None and all(n.value is not None and n.present == n.expected for n in both):
            found.append((method, both[0].value))
    return sorted(found, key=lambda pair: -pair[1])


def _order(ranking: list[tuple[str, float]]) -> str:
    return ", ".join(f"{method_title(method)} {value:.2f}" for method, value in ranking)


def _speed_findings(numbers: Numbers) -> Iterator[Finding]:
    for above, below, kind, what in (
        ("standard", "dedicated", "slowdown", "Standard is {low} to {high} times as fast as Dedicated"),
        (
            "dedicated",
            "non_engine",
            "against_native",
            "Dedicated runs at {low} to {high} times the frame rate of Non-Engine",
        ),
    ):
        cases = [
            _Case(ratio.value, key.dataset, key.method, f"{ratio.value:.1f}")
            for key, ratio in numbers.ratios.items()
            if (key.numerator, key.denominator) == (above, below) and ratio.value is not None
        ]
        if not cases:
            continue
        low, high = min(cases), max(cases)
        if len(cases) == 1:
            one = what.replace("{low} to {high}", low.detail)
            yield Finding(kind, f"{one} ({low.name}, by frame rate).", "slowdown")
        else:
            range_ = what.format(low=low.detail, high=high.detail)
            yield Finding(
                kind, f"{range_} (least {low.name}, most {high.name}; by mean frame rates).", "slowdown"
            )


def _structure_findings(numbers: Numbers) -> Iterator[Finding]:
    cases = [
        _Case(number.value, key.dataset, key.method, f"{100 * number.value:.0f} %")
        for key, number in numbers.values.items()
        if (key.scene, key.metric) == (MEAN, "nonmanifold_vertex_ratio") and number.value is not None
    ]
    if not cases:
        return
    low, high = min(cases), max(cases)
    label = f"mesh_connectivity-{slug(high.dataset)}"
    if high.value == 0:
        yield Finding(
            "structure", f"None of the exported meshes ({len(cases)} means) has a non-manifold vertex.", label
        )
        return
    pieces = numbers.value(Key(high.dataset, MEAN, high.method, "exported_mesh", "components"))
    sentence = f"{high.detail} of the vertices of {high.name} are non-manifold"
    if pieces is not None:
        count = text("components", pieces)
        sentence += f", in {count} {'piece' if count == '1' else 'pieces'}"
    if len(cases) > 1:
        sentence += f", the most of {len(cases)} means; the least are {low.detail}, of {low.name}"
    yield Finding("structure", f"{sentence}.", label)


def _unsupported_findings(numbers: Numbers) -> Iterator[Finding]:
    names: dict[str, dict[str, None]] = {}
    first = ""
    for key, number in numbers.values.items():
        if (
            (key.scene, key.metric) == (MEAN, "psnr")
            and number.value is None
            and number.absent == NOT_SUPPORTED
        ):
            names.setdefault(method_title(key.method), {})[condition_title(key.condition)] = None
            first = first or key.dataset
    if names:
        each = "; ".join(f"{name} under {' and '.join(conditions)}" for name, conditions in names.items())
        yield Finding("unsupported", f"Not supported: {each}.", f"renderer_comparison-{slug(first)}")
