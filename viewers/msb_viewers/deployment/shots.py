"""The compared renderer tiers, and the image of each tier or the reason why it is missing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Self

from msb.errors import Unsupported, UsageError, shorten

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.cl import Device
    from msb.render import Renderer
    from msb_viewers.deployment.views import View

TRUTH: Final = "truth"
REFERENCE: Final = "reference"
BAKED: Final = "baked"
# The title of each tier, in the order of the comparison. Photographs ("truth") and a baked mesh are treated
# like tiers.
LABELS = {
    TRUTH: "Ground truth",
    REFERENCE: "Reference",
    "dedicated": "Dedicated",
    "standard": "Standard",
    BAKED: "Baked",
}
# Maximum number of faces for which the reference tier is drawn by default. For a larger number of faces,
# NumPy needs minutes per view.
MOST_REFERENCE_FACES = 200_000


@dataclass(frozen=True, eq=False)
class Shot:
    """The image (H, W, 3) of a tier for a camera. If the image is missing, `why` is the reason.

    The image has the same pixels as the output of `msb render`. `milliseconds` is the time on the device
    without reading back the image, or the run time of NumPy. `nbytes` is the device memory of the tier.
    `where` is the name of the device.
    """

    tier: str
    image: NDArray[np.uint8] | None = None
    why: str = ""
    milliseconds: float | None = None
    nbytes: int | None = None
    where: str = ""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The compared renderer tiers and views, and the options of rendering.

    `missing` maps each missing tier to the reason why the method does not support the tier. `settings`
    override the settings of the asset. The standard tier uses `supersample`, and also draws the mesh `baked`.
    """

    name: str
    asset: Asset
    tiers: tuple[str, ...]
    missing: Mapping[str, str]
    views: tuple[View, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    supersample: int = 1
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    device: str | None = None
    baked: Asset | None = None

    @property
    def drawable(self) -> tuple[str, ...]:
        """The renderer tiers that have an image."""
        return tuple(tier for tier in self.tiers if tier not in self.missing)

    def settings_text(self) -> str:
        """Return the settings and the background as text. A star marks overridden settings."""
        from msb.asset.settings import effective_settings

        values = effective_settings(self.asset.manifest, self.settings)
        parts = [
            f"{name} {_value(value)}{'*' if name in self.settings else ''}" for name, value in values.items()
        ]
        if self.supersample > 1:
            parts.append(f"standard tier {self.supersample} x {self.supersample} samples")
        red, green, blue = (round(255 * channel) for channel in self.background)
        known = {(255, 255, 255): "white", (0, 0, 0): "black"}
        color = known.get((red, green, blue), f"#{red:02x}{green:02x}{blue:02x}")
        return ", ".join([*parts, f"background {color}"])


def choose_tiers(
    asset: Asset,
    views: Sequence[View],
    wanted: Iterable[str] | None,
    *,
    baked: Asset | None = None,
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the tiers of a comparison, and the reason for each tier without an image.

    By default, all tiers are compared. Photographs and the mesh `baked` are included if they exist. If the
    reference tier would take minutes, it is included only on request (`wanted`).
    """
    from msb.render.backend import check_supported

    photographs = any(view.photograph is not None for view in views)
    if wanted is None:
        slow = asset.manifest.face_count > MOST_REFERENCE_FACES
        left_out = {TRUTH} if not photographs else set()
        left_out |= {REFERENCE} if slow else set()
        left_out |= {BAKED} if baked is None else set()
        chosen = tuple(tier for tier in LABELS if tier not in left_out)
    else:
        names = [name for text in wanted for name in text.replace(" ", "").split(",")]
        for name in names:
            if name not in LABELS:
                text = f'the tier "{shorten(name, 40)}" is unknown; use some of {", ".join(LABELS)}'
                raise UsageError("NAME_UNKNOWN", text)
        if TRUTH in names and not photographs:
            text = "the tier truth needs photographs; pass --cameras and --image-folder"
            raise UsageError("NAME_UNKNOWN", text)
        if BAKED in names and baked is None:
            raise UsageError("NAME_UNKNOWN", "the tier baked needs a baked mesh; pass --baked FILE")
        chosen = tuple(tier for tier in LABELS if tier in names)
    # A tier is missing if the method does not support the tier. If all tiers are missing, raise the first
    # reason as an error.
    missing: dict[str, str] = {}
    first: Unsupported | None = None
    for tier in chosen:
        try:
            if tier == BAKED and baked is not None:
                check_supported(baked, "standard")
            elif tier != TRUTH:
                check_supported(asset, tier)
        except Unsupported as error:
            first = first or error
            missing[tier] = error.message
    if first is not None and all(tier in missing or tier == TRUTH for tier in chosen):
        raise first
    return chosen, missing


class TierRenderers:
    """The renderers of a comparison. Each renderer is created at its first use.

    Call `close` at the end, or use the object in a ``with`` block.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        self._renderers: dict[str, Renderer] = {}
        self._device: Device | None = None

    def shoot(self, tier: str, view: View) -> Shot:
        """Render a view on a tier."""
        if tier in self.comparison.missing:
            return Shot(tier, why=self.comparison.missing[tier])
        if tier == TRUTH:
            return self._truth(view)
        from msb.render.images import to_bytes

        renderer = self._renderer(tier)
        frame = renderer.render(view.camera, self.comparison.background)
        spent = sum(time for stage, time in frame.timings.items() if stage != "read")
        nbytes = sum(renderer.memory().values()) or None
        return Shot(tier, to_bytes(frame.image), "", spent, nbytes, self._where(tier))

    def shoot_all(self, view: View, tiers: Iterable[str] | None = None) -> dict[str, Shot]:
        """Render a view on all tiers, or on `tiers`."""
        chosen = self.comparison.tiers if tiers is None else tiers
        return {tier: self.shoot(tier, view) for tier in chosen}

    def close(self) -> None:
        """Release all renderers. `close` can be called twice."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        self._device = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _renderer(self, tier: str) -> Renderer:
        if tier not in self._renderers:
            from msb.cl import shared_device
            from msb.render import Renderer
            from msb.render.backend import minimal_options

            scene = self.comparison
            if tier != REFERENCE and self._device is None:
                self._device = shared_device(scene.device)
            device = None if tier == REFERENCE else self._device
            drawn: Any = "standard" if tier == BAKED else tier
            options = minimal_options(drawn, None)
            if drawn == "standard":
                options["supersample"] = scene.supersample
            asset, settings = scene.asset, scene.settings
            if tier == BAKED and scene.baked is not None:
                asset, settings = scene.baked, {}
            self._renderers[tier] = Renderer(asset, drawn, device, settings, **options)
        return self._renderers[tier]

    def _where(self, tier: str) -> str:
        if tier == REFERENCE or self._device is None:
            return "NumPy"
        return f"OpenCL on {self._device.record.name}"

    def _truth(self, view: View) -> Shot:
        from msb_viewers.deployment.views import read_photograph

        if view.photograph is None:
            return Shot(TRUTH, why=view.why)
        image = read_photograph(view, self.comparison.background)
        return Shot(TRUTH, image, where=f"photograph {view.photograph.name}")


def _value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value).lower()
