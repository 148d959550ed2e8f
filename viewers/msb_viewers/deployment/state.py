"""What the deployment viewer shows and what each key does to it. It needs no window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from msb.errors import UsageError, shorten
from msb_viewers.deployment.arrange import arrange
from msb_viewers.deployment.difference import TOPS
from msb_viewers.deployment.shots import BAKED, LABELS, MOST_REFERENCE_FACES, REFERENCE, TRUTH
from msb_viewers.deployment.views import Surroundings, sized
from msb_viewers.window import text_scale

if TYPE_CHECKING:
    from msb.scenes import Camera
    from msb_viewers.deployment.arrange import Cell
    from msb_viewers.deployment.shots import Comparison
    from msb_viewers.deployment.views import View

Layout = Literal["side", "wipe", "difference"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
LAYOUT_LABELS = {"side": "side by side", "wipe": "wipe", "difference": "difference"}
_STEP = 0.02
"""How far an arrow key moves the divider, in parts of the picture's width."""

HELP: tuple[tuple[str, str], ...] = (
    ("1 / 2 / 3", "side by side, wipe, difference"),
    ("A / B", "next tier for picture A, for picture B"),
    ("N / P", "next / previous camera of the dataset"),
    ("R", "compute the reference now, or stop it"),
    ("+ / -", "brighten / darken the difference"),
    ("← / →", "move the wipe's divider; or drag it"),
    ("G", "background: as given, black, white"),
    ("L", "captions on or off"),
    ("S", "save a screenshot"),
    ("Home", "back to the camera left, or first view"),
    ("Esc", "close this help"),
    ("Q", "close"),
    ("drag", "turn; Shift: move; wheel: zoom"),
    ("H", "this help"),
)
"""Key -> what it does, as the help shows it."""


@dataclass(eq=False)
class CompareState:
    """The viewer's switches.

    `pair` are the tiers A and B, which wipe and difference show; PSNRs are against A. They are equal if only
    one exists. `at` is the dataset's view that was shown last; `free` is the user's own camera, at any size,
    None while a dataset's is shown. `divider` is in parts of the picture's width; `top` is the difference
    that the brightest colour stands for; `reference` says to compute it when the view rests.
    """

    comparison: Comparison
    pair: tuple[str, str]
    around: Surroundings
    layout: Layout = "side"
    at: int | None = None
    free: Camera | None = None
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    divider: float = 0.5
    top: float = 0.25
    reference: bool = True
    help: bool = False
    captions: bool = True
    message: str = ""

    @classmethod
    def first(
        cls,
        comparison: Comparison,
        *,
        layout: Layout = "side",
        pair: str | None = None,
        up: str | None = None,
    ) -> CompareState:
        """Return the state a viewer opens with; `pair` is like "reference,standard", `up` like "+z"."""
        chosen = _default_pair(comparison) if pair is None else _parse_pair(comparison, pair)
        at = 0 if comparison.views else None
        around = Surroundings.of(comparison.asset, up)
        few = comparison.asset.manifest.face_count <= MOST_REFERENCE_FACES
        state = cls(comparison, chosen, around, layout, at, background=comparison.background, reference=few)
        state.home()
        state.message = "1: side by side   2: wipe   3: difference   A / B: tiers   N / P: cameras"
        if layout != "side" and chosen[0] == chosen[1]:
            text = f"--layout {layout} takes two tiers; only {chosen[0]} has a picture"
            raise UsageError("NAME_UNKNOWN", text)
        return state

    @property
    def aspect(self) -> float | None:
        """Width over height of the pictures; None if they take the shape of their place in the window."""
        if self.at is None:
            return None
        camera = self.comparison.views[self.at].camera
        return camera.width / camera.height

    @property
    def view(self) -> View | None:
        """The dataset's view that is shown; None while the camera is the user's own."""
        return self.comparison.views[self.at] if self.at is not None and self.free is None else None

    def home(self) -> None:
        """Go back to the dataset's camera, or to the first view."""
        self.free = self.around.first_camera() if self.at is None else None
        self.message = ""

    def picture_camera(self, size: tuple[int, int]) -> Camera:
        """Return the camera to draw for a window of `size` pixels.

        A dataset's has the dataset's size, so that its PSNRs are those of the protocol; a free one its box's.
        """
        if self.view is not None:
            return self.view.camera
        assert self.free is not None
        box = self.cells(size)[0].box
        if self.aspect is None:
            return sized(self.free, box.width, box.height)
        box = box.fitting(self.free.width, self.free.height)
        return self.free.resized(box.width, box.height)

    def cells(self, size: tuple[int, int]) -> list[Cell]:
        """Return where pictures go in a window of `size` pixels."""
        tiers, scale = self.comparison.tiers, text_scale(size)
        return arrange(self.layout, tiers, self.pair, size, scale, captions=self.captions, aspect=self.aspect)

    def set_layout(self, layout: Layout) -> None:
        """Show tiers side by side, with a wipe, or their difference."""
        if layout != "side" and self.pair[0] == self.pair[1]:
            self.message = f"there is only one picture, {LABELS[self.pair[0]].lower()}: nothing to compare"
            return
        self.layout = layout
        a, b = (LABELS[tier].lower() for tier in self.pair)
        self.message = {
            "side": "side by side",
            "wipe": f"wipe: A {a}, B {b}",
            "difference": f"difference of A {a} and B {b}",
        }[layout]

    def next_tier(self, side: int) -> None:
        """Put the next tier on side 0 (A) or 1 (B); what the other side shows is left out."""
        tiers = self.comparison.drawable
        other = self.pair[1 - side]
        choices = [tier for tier in tiers if tier != other]
        if not choices:
            self.message = "there is no other tier to compare with"
            return
        now = self.pair[side]
        chosen = choices[(choices.index(now) + 1) % len(choices)] if now in choices else choices[0]
        self.pair = (chosen, other) if side == 0 else (other, chosen)
        self.message = f"{'AB'[side]}: {LABELS[chosen].lower()}"

    def step(self, by: int) -> bool:
        """Go to the next or previous of the dataset's views; return whether there is one."""
        count = len(self.comparison.views)
        if not count:
            self.message = "there are no cameras to step through; --cameras names a dataset"
            return False
        self.at = ((-1 if self.at is None and by > 0 else self.at or 0) + by) % count
        self.free = None
        self.message = f"camera {self.at + 1} of {count}: {self.comparison.views[self.at].name}"
        return True

    def brighten(self, by: int) -> None:
        """Let the brightest colour stand for a smaller (+1) or larger (-1) difference."""
        at = min(max(TOPS.index(self.top) + by, 0), len(TOPS) - 1)
        self.top = TOPS[at]
        self.message = f"the brightest colour is a difference of {self.top:g} and more"

    def move_divider(self, by: int) -> None:
        """Move the divider by a step to the right (+1) or left (-1)."""
        self.divider = min(max(self.divider + by * _STEP, 0.0), 1.0)

    def toggle_reference(self) -> None:
        """Let the reference be computed when the view rests, or not."""
        if REFERENCE not in self.comparison.drawable:
            why = self.comparison.missing.get(REFERENCE, "it is not among the tiers shown")
            self.message = f"no reference: {why}"
            return
        self.reference = not self.reference
        self.message = "reference: computed when the view rests" if self.reference else "reference: off"

    def next_background(self) -> None:
        """Go on to the next background: the one given, black, white."""
        choices = list(dict.fromkeys([self.comparison.background, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)]))
        self.background = choices[(choices.index(self.background) + 1) % len(choices)]
        self.message = "background: " + ", ".join(f"{value:g}" for value in self.background)

    def toggle_captions(self) -> None:
        """Show captions, or not."""
        self.captions = not self.captions

    def close_help(self) -> None:
        """Close the list of keys, and say nothing."""
        self.help, self.message = False, ""

    def wanted_tiers(self) -> tuple[str, ...]:
        """Return the tiers whose pictures the layout shows."""
        if self.layout == "side":
            return self.comparison.tiers
        return tuple(tier for tier in self.comparison.tiers if tier in self.pair)


def _default_pair(comparison: Comparison) -> tuple[str, str]:
    """Return the truth, or else the method's own look, and what was baked, or the tier furthest from it."""
    tiers = comparison.drawable
    first = next(tier for tier in (TRUTH, "dedicated", REFERENCE, "standard", BAKED) if tier in tiers)
    rest = [tier for tier in (BAKED, "standard", "dedicated", REFERENCE) if tier in tiers and tier != first]
    return first, rest[0] if rest else first


def _parse_pair(comparison: Comparison, text: str) -> tuple[str, str]:
    names = [name.strip() for name in text.split(",")]
    known = comparison.drawable
    if len(names) != 2 or names[0] == names[1]:
        shown = shorten(text, 40)
        raise UsageError(
            "NAME_UNKNOWN", f'--pair is "{shown}"; it must be two tiers, like dedicated,standard'
        )
    for name in names:
        if name not in known:
            why = comparison.missing.get(name)
            shown = shorten(name, 40)
            text = f'--pair: "{shown}" has no picture here' + (f": {why}" if why else "")
            raise UsageError("NAME_UNKNOWN", f"{text}; there are {', '.join(known)}")
    return names[0], names[1]
