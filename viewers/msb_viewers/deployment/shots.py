"""The paths a picture can come by, and the pictures: what each path makes of one camera, or why it cannot."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Self

from msb.errors import Unsupported, UsageError, shorten

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.cl import Device
    from msb.render import Renderer
    from msb.scenes import Camera
    from msb_viewers.deployment.views import View

TRUTH: Final = "truth"
REFERENCE: Final = "reference"
LABELS = {
    TRUTH: "Ground truth",
    REFERENCE: "Reference",
    "dedicated": "Dedicated",
    "standard": "Standard",
}
"""Path -> its title, in the order in which they are shown; all but the truth are tiers."""
MOST_REFERENCE_FACES = 200_000
"""Of an asset whose reference is drawn without being asked for: NumPy takes minutes for more."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What a path made of a camera.

    Attributes
    ----------
    path : str
        A key of `LABELS`.
    image : (H, W, 3) uint8 or None
        As `msb render` writes it: clamped, rounded half up.
    why : str
        Why there is no image.
    milliseconds : float or None
        Time of the device's commands without reading back, or of NumPy; None of a photograph.
    nbytes : int or None
        Bytes the path holds on the device.
    where : str
        What computed it.
    """

    path: str
    image: NDArray[np.uint8] | None = None
    why: str = ""
    milliseconds: float | None = None
    nbytes: int | None = None
    where: str = ""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What is compared, and how it is drawn.

    Attributes
    ----------
    name : str
        What the window is called.
    asset : Asset
    paths : tuple of str
        Those shown, in the order of `LABELS`.
    missing : mapping of str to str
        Path -> why the method does not have it.
    views : tuple of View
        A dataset's; empty: free views only.
    settings : mapping
        Overrides of the asset's.
    supersample : int
        Samples along each side of a pixel on the standard tier.
    background : (float, float, float)
        In [0, 1].
    device : str or None
        As for `msb.Renderer`.
    """

    name: str
    asset: Asset
    paths: tuple[str, ...]
    missing: Mapping[str, str]
    views: tuple[View, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    supersample: int = 1
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    device: str | None = None

    @property
    def drawable(self) -> tuple[str, ...]:
        """The paths that can give a picture."""
        return tuple(path for path in self.paths if path not in self.missing)

    def settings_text(self) -> str:
        """Return the settings in force, with a star at those overridden, and the background."""
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


def choose_paths(
    asset: Asset, views: Sequence[View], wanted: Iterable[str] | None, *, headless: bool
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the paths to show, and why some of them have no picture.

    Parameters
    ----------
    wanted : iterable of str or None
        Those asked for; None means all tiers, and the truth where there is a photograph.
    headless : bool
        Every picture is waited for: a reference that would take minutes is then left out unless asked for.

    Raises
    ------
    UsageError
        `VIEW_PATH`: an unknown path, or truth without a photograph.
    Unsupported
        The method has none of the paths.
    """
    from msb.render.protocol import check_supported

    photographs = any(view.photograph is not None for view in views)
    if wanted is None:
        slow = headless and asset.manifest.face_count > MOST_REFERENCE_FACES
        left_out = {TRUTH} if not photographs else set()
        left_out |= {REFERENCE} if slow else set()
        chosen = tuple(path for path in LABELS if path not in left_out)
    else:
        names = [name for text in wanted for name in text.replace(" ", "").split(",") if name]
        for name in names:
            if name not in LABELS:
                text = f'there is no path "{shorten(name, 40)}"; there are {", ".join(LABELS)}'
                raise UsageError("VIEW_PATH", text, value=name)
        if TRUTH in names and not photographs:
            text = "there is no ground truth: no camera has a photograph; --cameras and --images name them"
            raise UsageError("VIEW_PATH", text, value=TRUTH)
        chosen = tuple(path for path in LABELS if path in names)
    missing: dict[str, str] = {}
    first: Unsupported | None = None
    for path in chosen:
        try:
            if path != TRUTH:
                check_supported(asset, path)
        except Unsupported as error:
            first = first or error
            missing[path] = error.message
    if first is not None and all(path in missing or path == TRUTH for path in chosen):
        raise first
    return chosen, missing


class PathRenderers:
    """Draws what a comparison shows, each path's renderer made when it is first needed.

    To be used from one thread. `close` it, or use it in a ``with`` block.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        self._renderers: dict[str, Renderer] = {}
        self._device: Device | None = None
        self._photograph: tuple[Any, Shot] | None = None

    def shoot(
        self,
        path: str,
        camera: Camera,
        view: View | None = None,
        background: tuple[float, float, float] | None = None,
    ) -> Shot:
        """Return what `path` makes of `camera`.

        Parameters
        ----------
        view : View, optional
            Whose camera it is, for its photograph.
        background : (float, float, float), optional
            Instead of the comparison's.

        Raises
        ------
        MsbError
            The renderer's own, but `Unsupported`: that becomes a shot that says why.
        """
        if path in self.comparison.missing:
            return Shot(path, why=self.comparison.missing[path])
        color = background or self.comparison.background
        if path == TRUTH:
            return self._truth(view, color)
        from msb.render.images import to_bytes

        renderer = self._renderer(path)
        frame = renderer.render(camera, color)
        spent = sum(time for stage, time in frame.timings.items() if stage != "read")
        nbytes = sum(renderer.memory().values()) or None
        return Shot(path, to_bytes(frame.image), "", spent, nbytes, self._where(path))

    def shoot_all(self, view: View, paths: Iterable[str] | None = None) -> dict[str, Shot]:
        """Return a shot of each path shown, or of `paths`, from one view. Raises as `shoot`."""
        chosen = self.comparison.paths if paths is None else paths
        return {path: self.shoot(path, view.camera, view) for path in chosen}

    def close(self) -> None:
        """Release all renderers. Twice is harmless."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        if self._device is not None:
            self._device.close()
            self._device = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _renderer(self, path: str) -> Renderer:
        if path not in self._renderers:
            from msb.cl import open_device
            from msb.render import Renderer
            from msb.render.protocol import lean_options

            scene = self.comparison
            settings = dict(scene.settings)
            if path == "standard":  # its own, whatever the method's setting of that name
                settings["supersample"] = scene.supersample
            if path != REFERENCE and self._device is None:
                self._device = open_device(scene.device)
            device = None if path == REFERENCE else self._device
            tier: Any = path
            self._renderers[path] = Renderer(scene.asset, tier, device, settings, **lean_options(tier, None))
        return self._renderers[path]

    def _where(self, path: str) -> str:
        if path == REFERENCE or self._device is None:
            return "NumPy"
        return f"OpenCL on {self._device.record.name}"

    def _truth(self, view: View | None, background: tuple[float, float, float]) -> Shot:
        from msb_viewers.deployment.views import read_photograph

        if view is None:
            return Shot(
                TRUTH, why="only the dataset's own cameras have a photograph; N and P step through them"
            )
        if view.photograph is None:
            return Shot(TRUTH, why=view.why)
        key = view, background
        if self._photograph is None or self._photograph[0] != key:
            image = read_photograph(view, background)
            self._photograph = key, Shot(TRUTH, image, where=f"photograph {view.photograph.name}")
        return self._photograph[1]


def _value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value).lower()
