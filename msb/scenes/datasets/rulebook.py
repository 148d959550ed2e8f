"""The rules by which datasets are read, by name: ours, and those of each method's official code."""

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
    photographs={
        "mipnerf360/outdoor": Photographs("images_4", instead=("images", 4)),
        "mipnerf360/indoor": Photographs("images_2", instead=("images", 2)),
        "tanksandtemples": Photographs(),
        "nerf_synthetic": Photographs(".", 2, "before_resize"),
        "dtu": Photographs(resolution=2, compositing="after_resize"),
        CUSTOM: Photographs(compositing="before_resize"),
    },
)


class _EveryRules(Mapping[str, Rules]):
    """Our own rules and those that methods declare, looked up when one is asked for."""

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


# Name -> rules: "ours", and the name of each method that declares some.
RULES: Mapping[str, Rules] = _EveryRules()


def evaluation_background(dataset: str, method: str | None = None, own: Color | None = None) -> Color:
    """Return the colour behind models in the benchmark: the dataset's, else that of the method's training.

    Masked datasets are evaluated over white whatever the method; where there is no mask each model keeps
    `own`, the background of its official evaluation; if it records none, that of its method, or black.
    """
    fixed = DATASETS[dataset].background if dataset in DATASETS else None
    return fixed or own or RULES.get(method or OURS, RULES[OURS]).background_of(dataset)


def stated_background(manifest: Manifest) -> Color | None:
    """Return the background of the model's official evaluation, None if the asset does not state it."""
    return parse_color("official", manifest.appearance.get("background"))


def own_background(manifest: Manifest) -> Color:
    """Return the colour over which a model is drawn where nobody names another and no dataset has its own.

    Every command and the Python interface take it: what the asset states, else what its method's official
    evaluation has, else black.
    """
    return evaluation_background(CUSTOM, manifest.method, stated_background(manifest))
