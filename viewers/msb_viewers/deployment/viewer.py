"""The deployment viewer's window: what the user does becomes orders, what comes back a picture."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from msb.errors import SceneError
from msb_viewers import drawing
from msb_viewers.camera import pose_of, scene_camera
from msb_viewers.deployment.compose import Composer
from msb_viewers.deployment.controls import CompareControls
from msb_viewers.deployment.painter import Order, Painter
from msb_viewers.deployment.shots import LABELS, REFERENCE, Shot, TierRenderers
from msb_viewers.deployment.solver import ReferenceSolver
from msb_viewers.window import Window, write_png

if TYPE_CHECKING:
    from msb_viewers.deployment.compose import Composition
    from msb_viewers.deployment.state import CompareState

_REST_SECONDS = 0.4
"""Seconds that the view must rest before the reference is begun."""
_TIMED_SECONDS = 0.5
"""Seconds between two changes of a text that says how long something has taken."""


class CompareViewer(Window):
    """The pictures of a comparison in a window, or off-screen.

    The view is VTK's camera, so that the mouse turns it as in the topology viewer; VTK draws nothing but the
    composed picture. Renderers run in a thread and a process of their own: see `painter`, `solver`.
    """

    def __init__(
        self, state: CompareState, *, size: tuple[int, int] = (1280, 800), off_screen: bool = False
    ) -> None:
        super().__init__(state.comparison.name, "compare", size, off_screen=off_screen)
        self.state: CompareState = state
        self.window.SetMultiSamples(0)  # a picture has no rims to smooth
        self._picture = drawing.Picture()
        self.renderer.AddViewProp(self._picture.actor)
        self.shots: dict[str, Shot] = {}
        self.composer = Composer()
        self.composition: Composition | None = None
        self._number = 0
        self._shown = 0
        self._moving = False
        self._rested_since = 0.0
        self._timed = 0.0
        self._begun = False
        self._painter = Painter(TierRenderers(state.comparison))
        self._solver = ReferenceSolver(state.comparison.asset, state.comparison.settings)
        self.controls: CompareControls = CompareControls(self)
        self.aim()
        self.request()
        self.refresh()

    # Where from --------------------------------------------------------------------------------------

    def aim(self) -> None:
        """Point VTK's camera where the state's looks, at what lies in the middle of the asset."""
        camera = self.state.picture_camera(self.size)
        around = self.state.around
        depth = float(camera.project(around.center)[1])
        self.pose = pose_of(camera, depth if depth > 0.1 * around.radius else around.radius)
        self._set_angle()

    def turned(self) -> None:
        """Take over what the mouse did to VTK's camera."""
        view = self.state.view
        like = self.state.free if view is None else view.camera
        assert like is not None
        try:
            self.state.free = scene_camera(self.pose, like)
        except SceneError as error:  # so far away, or so near, that there is no camera
            self.state.message = error.message
            self.aim()
            return
        self.request()

    def _set_angle(self) -> None:
        """Give VTK's camera the angle at which a pixel of the picture is a pixel of the window."""
        camera = self.state.picture_camera(self.size)
        box = self.state.cells(self.size)[0].box.fitting(camera.width, camera.height)
        focal = camera.fy * box.height / camera.height
        self.camera.SetViewAngle(math.degrees(2 * math.atan(self.size[1] / (2 * focal))))

    # What is drawn -----------------------------------------------------------------------------------

    def moving(self, on: bool) -> None:
        """Draw smaller pictures while the view moves, all of it when it rests."""
        if on != self._moving:
            self._moving = on
            if self.state.view is None:
                self.request()

    def request(self) -> None:
        """Have everything drawn that the state shows now."""
        self._number += 1
        self._rested_since, self._begun = time.monotonic(), False
        self._solver.cancel()
        self.shots.pop(REFERENCE, None)
        tiers = tuple(tier for tier in self.state.wanted_tiers() if not self._is_solved(tier))
        # What is of another camera must not be taken for this one's.
        self.shots = {tier: shot for tier, shot in self.shots.items() if self._stays(tier)}
        self._painter.ask(
            Order(
                self._number,
                self.state.picture_camera(self.size),
                self.state.view,
                tiers,
                self.state.background,
                self._moving,
            )
        )

    def _is_solved(self, tier: str) -> bool:
        return tier == REFERENCE and tier not in self.state.comparison.missing

    def _stays(self, tier: str) -> bool:
        """Return whether a shot may stay until the next is there, as the last moment of a movement may."""
        return self.state.view is None and not (self._moving and self._painter.skips(tier))

    def tick(self) -> bool:
        """Take over what has been drawn, go on with what is to be; return whether there is news."""
        news = False
        for order, shot in self._painter.collect():
            # While the view moves what is shown lags behind what was asked for, but never goes back.
            if order.number == self._number or (order.moving and order.number >= self._shown):
                self.shots[shot.tier], self._shown = shot, order.number
                news = True
        if self._wants_reference() and not self._begun and self._rested():
            self._begun = True
            self._solver.start(self.state.picture_camera(self.size), self.state.background)
            news = True
        found = self._solver.collect()
        if found is not None:
            self.shots[REFERENCE] = found
            news = True
        if self._solver.busy and time.monotonic() - self._timed > _TIMED_SECONDS:
            self._timed, news = time.monotonic(), True
        return news

    def _wants_reference(self) -> bool:
        state = self.state
        return state.reference and REFERENCE in state.wanted_tiers() and self._is_solved(REFERENCE)

    def _rested(self) -> bool:
        still = not self._moving and self._painter.idle
        return still and time.monotonic() - self._rested_since >= _REST_SECONDS

    @property
    def settled(self) -> bool:
        """Whether everything that the state shows has been drawn."""
        done = all(tier in self.shots for tier in self.state.wanted_tiers() if not self._is_solved(tier))
        if not (done and self._painter.idle):
            return False
        return not self._wants_reference() or (self._begun and self._solver.busy is None)

    def settle(self, seconds: float = 600.0) -> None:
        """Wait until everything is drawn, at most so long."""
        end = time.monotonic() + seconds
        while not self.settled and time.monotonic() < end:
            self.tick()
            time.sleep(0.005)
        self.tick()

    def busy(self) -> dict[str, str]:
        """Return, for each tier without a picture, what is being done about it."""
        texts = {}
        for tier in self.state.wanted_tiers():
            if not self._is_solved(tier):
                if tier not in self.shots:
                    title = LABELS[tier].lower()
                    texts[tier] = f"{title}: {'drawing' if self._painter.working == tier else 'waiting'}"
                    if self._moving and self._painter.skips(tier):
                        texts[tier] = f"{title}: slow, drawn when the view rests"
                continue
            if self._solver.busy:
                texts[tier] = self._solver.busy
            elif tier not in self.shots:
                title = LABELS[tier].lower()
                texts[tier] = f"{title}: begun when the view rests"
                if not self.state.reference:
                    texts[tier] = f"{title}: NumPy, slow; R computes it"
        return texts

    def refresh(self) -> None:
        """Bring the window up to date."""
        self.composition = self.composer.compose(self.state, self.shots, self.size, busy=self.busy())
        image = self.composition.image
        opaque = np.full((*image.shape[:2], 1), 255, np.uint8)
        self._picture.set(np.concatenate([image, opaque], axis=2))
        self._picture.place(0, 0)
        self.window.Render()

    def screenshot(self, path: Path) -> None:
        write_png(self.composer.compose(self.state, self.shots, self.size).image, path)

    def close(self) -> None:
        """End thread and child, and let go of the window."""
        self._solver.close()
        self._painter.close()
        super().close()
