"""The numbers of tables, charts and findings, by dataset, scene, method, condition and metric.

Measured numbers come from result records (`msb.report.collect`), the paper's numbers from its published
tables (`msb.report.paper`). Tables, charts and findings treat measured and published numbers in the same way.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from msb.bench.aggregate import CONDITION_TITLES, SCENES, TITLES
from msb.bench.gaps import Gaps, Ratio
from msb.bench.intervals import Interval
from msb.bench.records import BAKED, TIER_OF
from msb.bench.split import Split
from msb.metrics.registry import IMAGE_METRICS
from msb.registry import METHODS
from msb.report.safe_names import plain_text
from msb.report.table import NOT_AVAILABLE

# Values of `Key.scene` that mean an average over the scenes of a dataset.
MEAN = "mean"
# The cost of a single triangle, averaged over the scenes. The cost of a single triangle does not depend on
# the mesh.
FLOOR = "floor_mean"
# The heading of each row of averages. The keys of the mapping are values of `Key.scene`.
MEANS = {"indoor_mean": "Indoor mean", "outdoor_mean": "Outdoor mean", MEAN: "Mean", FLOOR: "Floor"}

# Conditions with images, in the order of decreasing quality: Non-Engine, Dedicated, Standard.
DRAWN_CONDITIONS = tuple(TIER_OF)

# Image quality metrics. The mapping is filled at the first access, because other packages can add metrics.
QUALITY = IMAGE_METRICS
# Metrics of the trained model, independent of the renderer. Tables show metrics of the trained model beside
# the Non-Engine results.
ASSET_METRICS = ("train_memory", "train_seconds", "chamfer")
# The first words of the note that a frame rate was measured on a CPU. On a CPU, the frame rate depends on
# other running programs, so it is never marked as the best.
ON_CPU = "measured on a CPU device"


class Key(NamedTuple):
    """Identifies a number.

    Attributes
    ----------
    dataset, method : str
    scene : str
        The name of a scene, or a key of `MEANS`.
    condition : str
        "non_engine", "dedicated", "standard" or "exported_mesh". "dedicated/NAME" is a variant of the
        dedicated tier, "standard/NAME" is the standard tier in another engine, and "baked/NAME" is a baked
        mesh.
    metric : str
        A key of `msb.bench.aggregate.METRICS`.
    source : str
        The origin of the number: "" if measured, otherwise a key of
        `msb.report.tables.reproducibility.SOURCES`.
    """

    dataset: str
    scene: str
    method: str
    condition: str
    metric: str
    source: str = ""

    @property
    def is_of_asset(self) -> bool:
        """Whether the number describes the trained model.

        A number that describes the trained model can have a condition without images, such as an exported
        mesh.
        """
        return self.metric in ASSET_METRICS


@dataclass(frozen=True)
class Number:
    """A number, or the reason for its absence.

    Attributes
    ----------
    value : float or None
        The value in the unit of the records.
    absent : str
        Text printed for a missing value: "N/A" (not supported), "unsteady" or "--".
    reason : str or None
        The reason for a missing value.
    present, expected : int
        The number of averaged scenes, and the number of all scenes.
    notes : tuple of str
        Footnotes.
    interval : Interval or None
        95 % confidence interval of a mean over views.
    """

    value: float | None
    absent: str = NOT_AVAILABLE
    reason: str | None = None
    present: int = 1
    expected: int = 1
    notes: tuple[str, ...] = ()
    interval: Interval | None = None


class GapKey(NamedTuple):
    """The key of a method's three quality gaps.

    `scene` is the name of a scene, or "mean". `standard` and `dedicated` name the two conditions that are
    compared. By default, the two tiers are compared. `standard` can also be another engine or a bake.
    `dedicated` can also be a variant.
    """

    dataset: str
    scene: str
    method: str
    metric: str
    standard: str = "standard"
    dedicated: str = "dedicated"

    @property
    def is_between_tiers(self) -> bool:
        """Whether the gaps compare the tiers Standard and Dedicated."""
        return (self.standard, self.dedicated) == ("standard", "dedicated")


class SplitKey(NamedTuple):
    """The key of the parts of a quality loss. `scene` is the name of a scene, or "mean"."""

    dataset: str
    scene: str
    method: str
    metric: str


class RatioKey(NamedTuple):
    """The key of a ratio of frame rates. The ratio compares two conditions on a dataset."""

    dataset: str
    method: str
    numerator: str
    denominator: str


@dataclass(frozen=True)
class Numbers:
    """All numbers of a set of results, or all numbers of the paper.

    Attributes
    ----------
    values : mapping of Key to Number
        The numbers in table order: by dataset, method and scene.
    gaps, ratios, splits : mappings
        Quality gaps, ratios of frame rates, and parts of quality losses.
    views : mapping of Key to a mapping of str to float
        The value of an image metric in each view of a single scene.
    drawn_by : mapping of str to a mapping of str to str
        The renderer by dataset and condition: "OpenCL", the name of an engine, or "their own code".
    verdicts : mapping of Key to str
        Audit verdict ("ok", "limited", "bad") of each exported or baked mesh. The keys contain "" in place of
        a metric.
    of_paper : bool
        Whether the numbers are the paper's numbers.
    """

    values: Mapping[Key, Number]
    gaps: Mapping[GapKey, Gaps] = field(default_factory=dict)
    ratios: Mapping[RatioKey, Ratio] = field(default_factory=dict)
    views: Mapping[Key, Mapping[str, float]] = field(default_factory=dict)
    drawn_by: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    splits: Mapping[SplitKey, Split] = field(default_factory=dict)
    verdicts: Mapping[Key, str] = field(default_factory=dict)
    of_paper: bool = False

    def number(self, key: Key) -> Number:
        """Return the number at `key`.

        For an unknown key, the result is a missing number with the text "--".
        """
        return self.values.get(key, Number(None))

    def value(self, key: Key) -> float | None:
        """Return the value at `key`, or None."""
        return self.number(key).value

    def datasets(self) -> list[str]:
        """Return the datasets."""
        return list(self._keys)

    def methods(self, dataset: str, *conditions: str, asset_metrics: Sequence[str] = ()) -> list[str]:
        """Return the methods of a dataset.

        Parameters
        ----------
        dataset : str
        conditions : str
            Only methods with a record of one of these conditions are returned.
        asset_metrics : sequence of str
            Methods whose trained model has a value of one of these metrics are also returned.
        """
        keys = (
            key
            for key in self._keys.get(dataset, ())
            if not conditions
            or (
                key.condition in conditions
                and (not key.is_of_asset or (key.metric in asset_metrics and self.value(key) is not None))
            )
        )
        return list(dict.fromkeys(key.method for key in keys))

    def has_other_scenes(self, dataset: str) -> bool:
        """Return whether a dataset has the name of a published dataset, but none of its scenes."""
        published, scenes = SCENES.get(dataset, ()), self.scenes(dataset)
        return bool(published and scenes) and not any(scene in published for scene in scenes)

    def scenes(self, dataset: str) -> list[str]:
        """Return the scenes of a dataset, without averages."""
        return list(dict.fromkeys(key.scene for key in self._keys.get(dataset, ()) if key.scene not in MEANS))

    def conditions(self, dataset: str) -> list[str]:
        """Return the conditions with images.

        Each tier precedes its variants or engines, and bakes are last.
        """
        conditions = dict.fromkeys(
            key.condition
            for key in self._keys.get(dataset, ())
            if key.condition != "exported_mesh" and not key.is_of_asset
        )
        return sorted(conditions, key=condition_order)

    def variants(self, dataset: str, condition: str) -> list[str]:
        """Return all variants of "dedicated", all engines of "standard", or all bakes of "baked"."""
        return select_variants(self.conditions(dataset), condition)

    def gap_pairs(self, dataset: str) -> list[tuple[str, str]]:
        """Return all pairs of conditions (standard, dedicated) for quality gaps."""
        return list_gap_pairs(self.conditions(dataset), self.drawn_by.get(dataset, {}))

    def ratio_pairs(self, dataset: str) -> list[tuple[str, str]]:
        """Return all pairs of conditions (standard, dedicated) for ratios of frame rates."""
        return list_ratio_pairs(self.conditions(dataset), self.drawn_by.get(dataset, {}))

    @cached_property
    def _keys(self) -> dict[str, list[Key]]:
        """For each dataset, the keys of all numbers."""
        keys: dict[str, list[Key]] = {}
        for key in self.values:
            keys.setdefault(key.dataset, []).append(key)
        return keys


def dataset_title(dataset: str) -> str:
    """Return the heading of a dataset."""
    return TITLES.get(dataset) or plain_text(dataset)


def scene_title(scene: str) -> str:
    """Return the heading of a scene or of an average."""
    return MEANS.get(scene) or plain_text(scene)


def method_title(method: str) -> str:
    """Return the heading of a method."""
    return METHODS[method].title if method in METHODS else plain_text(method)


def select_variants(conditions: Iterable[str], condition: str) -> list[str]:
    """Return all names in `conditions` that begin with the name `condition` and a slash."""
    return [name for name in conditions if name.startswith(f"{condition}/")]


def list_gap_pairs(conditions: Sequence[str], drawn_by: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return all pairs of conditions (standard, dedicated) for quality gaps.

    The two tiers form a pair. Standard also forms a pair with each variant of Dedicated. Each engine forms a
    pair with Dedicated. Each bake also forms a pair with Dedicated. If one engine draws both tiers, its two
    conditions also form a pair.
    """
    variants = select_variants(conditions, "dedicated")
    pairs = [
        *(("standard", dedicated) for dedicated in ("dedicated", *variants)),
        *((engine, "dedicated") for engine in select_variants(conditions, "standard")),
        *list_ratio_pairs(conditions, drawn_by),
        *((bake, "dedicated") for bake in select_variants(conditions, BAKED)),
    ]
    return list(dict.fromkeys(pairs))


def list_ratio_pairs(conditions: Sequence[str], drawn_by: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return all pairs of conditions (standard, dedicated) for ratios of frame rates.

    If an engine draws both tiers, its Dedicated condition and variants are paired with its Standard
    condition. If no engine draws both tiers, Dedicated and its variants are paired with the Standard
    condition. Frame rates of two engines are not compared, because they may be measured on different devices.
    """
    engines = {drawn_by.get(name): name for name in select_variants(conditions, "standard")}
    dedicated = ("dedicated", *select_variants(conditions, "dedicated"))
    return [(engines.get(drawn_by.get(name, ""), "standard"), name) for name in dedicated]


def condition_order(condition: str) -> tuple[int, bool]:
    """Return the sort key of a condition.

    Tiers are in the order of `CONDITION_TITLES`, each followed by its variants.
    """
    tier, slash, _ = condition.partition("/")
    return list(CONDITION_TITLES).index(tier), bool(slash)


def condition_title(condition: str) -> str:
    """Return the heading of a condition, such as "Dedicated" or "Baked, ceiling"."""
    tier, _, name = condition.partition("/")
    return f"{CONDITION_TITLES[tier]}, {plain_text(name)}" if name else CONDITION_TITLES[tier]
