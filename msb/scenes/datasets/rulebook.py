"""The rules for reading datasets, by name: our rules, and the rules of each method's official code."""

from collections.abc import Iterator, Mapping

from msb.asset.manifest import Manifest
from msb.registry import METHODS
from msb.scenes.colors import Color, parse_color
from msb.scenes.datasets.catalog import CUSTOM, DATASETS
from msb.scenes.datasets.rules import Photographs, Rules

OURS = "ours"
_OURS = Rules(
    "MeshSplatBench",
    "docs/datasets.md",
    convention="full_K",
    photographs={
        "mipnerf360/outdoor": Photographs("images_4", instead=("images", 4)),
        "mipnerf360/indoor": Photographs("images_2", instead=("images", 2)),
        "tanksandtemples": Photographs(),
        "nerf_synthetic": Photographs(".", 2, "before_resize", divided_size=(400, 400)),
        "dtu": Photographs(resolution=2, compositing="after_resize"),
        CUSTOM: Photographs(compositing="before_resize"),
    },
)


class _EveryRules(Mapping[str, Rules]):
    """Mapping of our rules, and of the rules that methods declare.

    The rules of a method are imported at their first use.
    """

    def __getitem__(self, name: str) -> Rules:
        rules = _OURS if name == OURS else METHODS[name].rules
        if rules is None:
            raise KeyError(name)
        return rules

    def __iter__(self) -> Iterator[str]:
        yield OURS
        yield from (name for name, method in METHODS.items() if method.rules is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)


# The rules by name: "ours", and each method that declares rules.
RULES: Mapping[str, Rules] = _EveryRules()


def evaluation_background(dataset: str, method: str | None = None, recorded: Color | None = None) -> Color:
    """Return the background of a model in the benchmark.

    Masked datasets are evaluated over a white background for every method. On all other datasets, the
    background is `recorded`, the background of the model's official evaluation. If the model records no
    background, the background is the method's background, or black.
    """
    fixed = DATASETS[dataset].background if dataset in DATASETS else None
    return fixed or recorded or RULES.get(method or OURS, RULES[OURS]).background_of(dataset)


def stated_background(manifest: Manifest) -> Color | None:
    """Return the background of the model's official evaluation.

    If the asset does not record the background, return None.
    """
    return parse_color("official", manifest.appearance.get("background"))


def default_background(manifest: Manifest) -> Color:
    """Return the background of the asset.

    If the asset records no background, return the method's background, or black.

    All commands and the Python interface use this background, unless the user or a dataset sets another
    background.
    """
    return evaluation_background(CUSTOM, manifest.method, stated_background(manifest))
