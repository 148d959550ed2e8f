"""Rank methods by a metric, and find pairs of methods whose order differs between two rankings."""

from itertools import combinations

from msb.bench.aggregate import METRICS
from msb.bench.intervals import Interval, interval
from msb.report.metric_format import format_value
from msb.report.numbers import MEAN, ON_CPU, Key, Numbers, method_title

# Methods with their averages of a metric, best method first.
Ranking = list[tuple[str, float]]


def rank_methods(numbers: Numbers, dataset: str, condition: str, metric: str) -> Ranking:
    """Return the methods with complete averages, best method first.

    Frame rates measured on a CPU are not ranked.
    """
    means = [
        (method, number.value)
        for method in numbers.methods(dataset)
        if (number := numbers.number(Key(dataset, MEAN, method, condition, metric))).value is not None
        and number.present == number.expected
        and not any(note.startswith(ON_CPU) for note in number.notes)
    ]
    return sorted(means, key=lambda item: item[1], reverse=METRICS[metric].better == "higher")


def rank_common_methods(numbers: Numbers, dataset: str, condition: str, other: str) -> Ranking:
    """Return the PSNR ranking in `condition`.

    Methods without complete averages in both conditions are omitted.
    """
    methods = dict(rank_methods(numbers, dataset, other, "psnr"))
    return [item for item in rank_methods(numbers, dataset, condition, "psnr") if item[0] in methods]


def is_ahead(metric: str, value: float, other: float) -> bool:
    """Return whether `value` is better than `other` by at least one unit of the last printed digit."""
    difference = value - other if METRICS[metric].better == "higher" else other - value
    return difference >= METRICS[metric].last_digit


def find_swaps(
    before: Ranking, after: Ranking, metric: str = "psnr", after_metric: str = "psnr"
) -> list[tuple[str, str]]:
    """Return the pairs of methods whose order differs between two rankings.

    In both rankings, the two methods must differ by at least one unit of the last printed digit. The first
    ranking uses `metric`, and the second ranking uses `after_metric`.
    """
    values = dict(after)
    return [
        (better, worse)
        for (better, first), (worse, second) in combinations(before, 2)
        if is_ahead(metric, first, second) and is_ahead(after_metric, values[worse], values[better])
    ]


def find_most_certain_swap(
    numbers: Numbers, dataset: str, swaps: list[tuple[str, str]], conditions: tuple[str, str]
) -> Interval:
    """Return the t test of the most significant pair of methods among `swaps`.

    Two methods are a swapped pair if their order differs between the two conditions.

    For each pair, the difference between the two methods is tested under both conditions. The p value of the
    pair is the larger p value of these two tests. The pair with the smallest p value is returned.
    """

    def p_value(difference: Interval) -> float:
        # if a difference was not tested, its value is larger than every p value
        return 2.0 if difference.p is None else difference.p

    def test_difference(pair: tuple[str, str], condition: str) -> Interval:
        scenes = []
        for scene in numbers.scenes(dataset):
            keys = (Key(dataset, scene, method, condition, "psnr") for method in pair)
            values, others = (numbers.views.get(key, {}) for key in keys)
            if common := [values[view] - others[view] for view in values if view in others]:
                scenes.append(common)
        return interval(scenes)

    tests = (
        max((test_difference(pair, condition) for condition in conditions), key=p_value) for pair in swaps
    )
    return min(tests, key=p_value)


def format_ranking(ranking: Ranking, metric: str = "psnr") -> str:
    """Return a text such as "2DTS 28.16, 3DGS 27.21"."""
    return ", ".join(f"{method_title(method)} {format_value(metric, value)}" for method, value in ranking)
