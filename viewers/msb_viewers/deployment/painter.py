"""A thread that draws beside the window: the newest order counts, and the window never waits."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msb.errors import MsbError
from msb_viewers.deployment.shots import TRUTH, Shot

if TYPE_CHECKING:
    from msb.scenes import Camera
    from msb_viewers.deployment.shots import TierRenderers
    from msb_viewers.deployment.views import View

FLUID_SECONDS = 0.06
"""Seconds that the pictures of one moment of a movement may take together."""
STEPS = (1.0, 0.75, 0.5, 0.35, 0.25, 0.18, 0.125)
"""Sizes of pictures while moving, relative to those at rest; they are few, so that buffers are reused."""
TOO_SLOW = 0.25
"""A tier that twice takes more seconds at the smallest size is drawn only when the view rests."""
_PATIENCE = 20.0
"""Seconds that closing waits for a picture that is being drawn."""


@dataclass(frozen=True, eq=False)
class Order:
    """What is to be drawn at rest, or at once and at a size that allows it while the view is `moving`.

    Later orders have higher numbers. `camera` is at full size; it belongs to `view`, if to any.
    """

    number: int
    camera: Camera
    view: View | None
    tiers: tuple[str, ...]
    background: tuple[float, float, float]
    moving: bool


class Painter:
    """A thread that draws orders.

    At rest each picture is handed over when it is done, and a new order interrupts between two. While moving
    the pictures of one order are handed over together, so that what is compared is of one camera.
    """

    def __init__(self, renderers: TierRenderers) -> None:
        self._renderers = renderers
        self._wanted: Order | None = None
        self._done: deque[tuple[Order, Shot]] = deque()
        self._changed = threading.Condition()
        self._stop = False
        self.scale = 1.0
        self.working: str | None = None
        """The tier that is being drawn."""
        self._slow: dict[str, int] = {}
        self._thread = threading.Thread(target=self._run, name="painter", daemon=True)
        self._thread.start()

    def ask(self, order: Order) -> None:
        """Draw this next; orders not yet begun are forgotten."""
        with self._changed:
            self._wanted = order
            self._changed.notify()

    def collect(self) -> list[tuple[Order, Shot]]:
        """Return what was drawn since the last call, oldest first."""
        return [self._done.popleft() for _ in range(len(self._done))]

    @property
    def idle(self) -> bool:
        """Whether everything asked for is done."""
        with self._changed:
            return self._wanted is None and self.working is None

    def skips(self, tier: str) -> bool:
        """Return whether a tier is too slow to be drawn while the view moves."""
        return self._slow.get(tier, 0) > 1

    def close(self) -> None:
        """Stop, and release the renderers in the thread that made them."""
        with self._changed:
            self._stop = True
            self._changed.notify()
        self._thread.join(_PATIENCE)

    def _run(self) -> None:
        with self._renderers:
            while True:
                with self._changed:
                    self.working = None
                    self._changed.wait_for(lambda: self._stop or self._wanted is not None)
                    if self._stop:
                        return
                    order, self._wanted = self._wanted, None
                    assert order is not None
                    self.working = order.tiers[0] if order.tiers else None
                (self._moving if order.moving else self._resting)(order)

    def _resting(self, order: Order) -> None:
        spent = 0.0
        for tier in order.tiers:
            if self._stop or self._wanted is not None:
                return
            shot, seconds = self._shoot(tier, order, order.camera)
            spent += seconds
            if seconds <= TOO_SLOW:
                self._slow.pop(tier, None)
            self._done.append((order, shot))
        self.scale = moving_scale(1.0, spent)

    def _moving(self, order: Order) -> None:
        camera = order.camera.scaled(self.scale)
        shots, spent = [], 0.0
        for tier in order.tiers:
            if self.skips(tier):
                continue
            shot, seconds = self._shoot(tier, order, camera)
            shots.append(shot)
            spent += seconds
            if self.scale == STEPS[-1] and seconds > TOO_SLOW:
                self._slow[tier] = self._slow.get(tier, 0) + 1
        self._done.extend((order, shot) for shot in shots)
        self.scale = moving_scale(self.scale, spent)

    def _shoot(self, tier: str, order: Order, camera: Camera) -> tuple[Shot, float]:
        self.working = tier
        start = time.perf_counter()
        try:
            view = order.view if tier == TRUTH else None
            shot = self._renderers.shoot(tier, camera, view, order.background)
        except MsbError as error:
            shot = Shot(tier, why=str(error))
        except MemoryError:
            shot = Shot(tier, why="there is too little memory for a picture of this size")
        except Exception as error:  # a broken driver must not leave a window that waits for ever
            shot = Shot(tier, why=f"{type(error).__name__}: {error}")
        return shot, time.perf_counter() - start


def moving_scale(scale: float, seconds: float) -> float:
    """Return the size for the next picture of a movement, if one at `scale` took `seconds`.

    >>> moving_scale(1.0, 0.02), moving_scale(1.0, 0.24), moving_scale(0.25, 0.0015), moving_scale(0.5, 9)
    (1.0, 0.5, 1.0, 0.125)
    """
    if seconds <= 0:
        return scale
    allowed: Any = scale * (FLUID_SECONDS / seconds) ** 0.5
    return next((step for step in STEPS if step <= allowed), STEPS[-1])
