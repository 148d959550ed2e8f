"""What tables, figures and findings are made of: numbers by dataset, scene, method, condition and metric.

Ours come from records (`msb.report.collect`), the paper's from its tables (`msb.report.paper`); from here on
both take the same way.
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
from msb.report.table import NOT_THERE

MEAN = "mean"
FLOOR = "floor_mean"
# Names that stand for means over scenes -> the headings of their rows; a floor is of one triangle alone.
MEANS = {"indoor_mean": "Indoor mean", "outdoor_mean": "Outdoor mean", MEAN: "Mean", FLOOR: "Floor"}

# The conditions that hold images, in the order in which quality is lost.
DRAWN_CONDITIONS = tuple(TIER_OF)

# The metrics of images; looked into no earlier than needed, since packages bring some.
QUALITY = IMAGE_METRICS
# Metrics of the trained model, shown with the Non-Engine results, whichever record holds them.
OF_ASSET = ("train_memory", "train_seconds", "chamfer")
# Begins the note on a rate that says as much of what else the machine did: it is not marked as the best.
ON_CPU = "measured on a CPU device"


class Key(NamedTuple):
    """What a number is of: `scene` may be a key of `MEANS`; `metric` is one of `msb.bench.aggregate.METRICS`.

    `condition` is "standard/NAME" where an engine draws in its place, "dedicated/NAME" of a variant,
    "baked/NAME" of a bake. `source`
    is "" for measured numbers, and a key of `msb.report.tables.reproducibility.SOURCES` for published ones.
    """

    dataset: str
    scene: str
    method: str
    condition: str
    metric: str
    source: str = ""

    @property
    def of_asset(self) -> bool:
        """Whether the number is of the model itself, so that it says nothing of there being images."""
        return self.metric in OF_ASSET


@dataclass(frozen=True)
class Number:
    """A number in the records' unit, or `reason` why there is none and `absent`, "N/A" or "--", in its place.

    A mean is over `present` of the `expected` scenes; `interval` is that of a mean over views.
    """

    value: float | None
    absent: str = NOT_THERE
    reason: str | None = None
    present: int = 1
    expected: int = 1
    notes: tuple[str, ...] = ()
    interval: Interval | None = None


class GapKey(NamedTuple):
    """What gaps are of. `scene` may be "mean".

    `standard` and `dedicated` are the conditions in the place of the two tiers: an engine's or a bake's, and
    a variant's.
    """

    dataset: str
    scene: str
    method: str
    metric: str
    standard: str = "standard"
    dedicated: str = "dedicated"

    @property
    def own_tiers(self) -> bool:
        """Whether the gaps are between the tiers themselves, with neither engine nor variant."""
        return (self.standard, self.dedicated) == ("standard", "dedicated")


class SplitKey(NamedTuple):
    """What the parts of a loss are of. `scene` may be "mean"."""

    dataset: str
    scene: str
    method: str
    metric: str


class RatioKey(NamedTuple):
    """What a ratio of frame rates is of: two conditions, in the means over a dataset."""

    dataset: str
    method: str
    numerator: str
    denominator: str


@dataclass(frozen=True)
class Numbers:
    """All numbers of a set of results, or of the paper (`of_paper`). Names come in the order of `values`.

    `views` has the values of every view, of the image metrics of a scene; `drawn_by` what drew a dataset's
    condition: "OpenCL", an engine, the methods' own code; `verdicts` that of the audit of each exported mesh
    and bake, whose key has no metric.
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
        """Return the number at `key`, or -- where nothing is known about it."""
        return self.values.get(key, Number(None))

    def value(self, key: Key) -> float | None:
        return self.number(key).value

    def datasets(self) -> list[str]:
        """Return the datasets."""
        return list(self._keys)

    def methods(self, dataset: str, *conditions: str, of_asset: Sequence[str] = ()) -> list[str]:
        """Return the methods of a dataset; if `conditions` are named, those with a record of one.

        The metrics `of_asset`, of the model itself, do as well where they have a value.
        """
        own = (
            key
            for key in self._keys.get(dataset, ())
            if not conditions
            or (
                key.condition in conditions
                and (not key.of_asset or (key.metric in of_asset and self.value(key) is not None))
            )
        )
        return list(dict.fromkeys(key.method for key in own))

    def has_other_scenes(self, dataset: str) -> bool:
        """Return whether a dataset has a published name but none of its scenes, such as the stubs."""
        published, scenes = SCENES.get(dataset, ()), self.scenes(dataset)
        return bool(published and scenes) and not any(scene in published for scene in scenes)

    def scenes(self, dataset: str) -> list[str]:
        """Return the scenes of a dataset, means apart."""
        return list(dict.fromkeys(key.scene for key in self._keys.get(dataset, ()) if key.scene not in MEANS))

    def conditions(self, dataset: str) -> list[str]:
        """Return the conditions that hold images, each followed by its variants or engines; then bakes."""
        conditions = dict.fromkeys(
            key.condition
            for key in self._keys.get(dataset, ())
            if key.condition != "exported_mesh" and not key.of_asset
        )
        return sorted(conditions, key=condition_order)

    def in_place_of(self, dataset: str, condition: str) -> list[str]:
        """Return the variants or engines of a condition in a dataset, or the bakes of "baked"."""
        return in_place_of(self.conditions(dataset), condition)

    def gap_tiers(self, dataset: str) -> list[tuple[str, str]]:
        """Return the pairs (standard, dedicated) that gaps of a dataset go through."""
        return gap_tiers(self.conditions(dataset), self.drawn_by.get(dataset, {}))

    def ratio_tiers(self, dataset: str) -> list[tuple[str, str]]:
        """Return the pairs (standard, dedicated) whose frame rates are held against each other."""
        return ratio_tiers(self.conditions(dataset), self.drawn_by.get(dataset, {}))

    @cached_property
    def _keys(self) -> dict[str, list[Key]]:
        """Dataset -> the keys of its numbers."""
        keys: dict[str, list[Key]] = {}
        for key in self.values:
            keys.setdefault(key.dataset, []).append(key)
        return keys


def dataset_title(dataset: str) -> str:
    """Return a dataset's heading."""
    return TITLES.get(dataset) or plain_text(dataset)


def scene_title(scene: str) -> str:
    """Return the heading of a scene, or of a mean of scenes."""
    return MEANS.get(scene) or plain_text(scene)


def method_title(method: str) -> str:
    """Return a method's heading."""
    return METHODS[method].title if method in METHODS else plain_text(method)


def in_place_of(conditions: Iterable[str], condition: str) -> list[str]:
    """Return those of `conditions` that are variants or engines of one, or the bakes of "baked"."""
    return [name for name in conditions if name.startswith(f"{condition}/")]


def gap_tiers(conditions: Sequence[str], drawn_by: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the pairs (standard, dedicated) that gaps go through.

    They are the tiers, each variant, each engine, each engine's two tiers where it draws both, and each bake.
    """
    variants = in_place_of(conditions, "dedicated")
    pairs = [
        *(("standard", dedicated) for dedicated in ("dedicated", *variants)),
        *((engine, "dedicated") for engine in in_place_of(conditions, "standard")),
        *ratio_tiers(conditions, drawn_by),
        *((bake, "dedicated") for bake in in_place_of(conditions, BAKED)),
    ]
    return list(dict.fromkeys(pairs))


def ratio_tiers(conditions: Sequence[str], drawn_by: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the pairs (standard, dedicated) whose frame rates may be held against each other.

    With Dedicated and each variant of it goes the Standard of the engine that draws it, where there is one:
    rates of two engines are of two devices.
    """
    engines = {drawn_by.get(name): name for name in in_place_of(conditions, "standard")}
    dedicated = ("dedicated", *in_place_of(conditions, "dedicated"))
    return [(engines.get(drawn_by.get(name, ""), "standard"), name) for name in dedicated]


def condition_order(condition: str) -> tuple[int, bool]:
    """Return what conditions are sorted by: as quality is lost, each followed by its variants or engines."""
    own, slash, _ = condition.partition("/")
    return list(CONDITION_TITLES).index(own), bool(slash)


def condition_title(condition: str) -> str:
    """Return a condition's heading, with the variant's, engine's or bake's name behind it."""
    own, _, name = condition.partition("/")
    return f"{CONDITION_TITLES[own]}, {plain_text(name)}" if name else CONDITION_TITLES[own]
