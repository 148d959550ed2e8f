"""Time a renderer: device latency and wall-clock rate over a set of cameras, apart from any capture.

Nothing is written and no pixel is read back while the clock runs. How many cameras it sees depends on how
fast the machine is; the memory a renderer takes must not, so the cameras not seen are drawn afterwards.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from msb.bench.records import Timing
from msb.bench.timing import Timing as Options
from msb.render.backend import SETTLED_AT, Drawn

if TYPE_CHECKING:
    from msb.render import Renderer
    from msb.scenes import Camera

WARM_UP_FRAMES = 10
WARM_UP_SECONDS = 1.0
ROUNDS = 5


@dataclass(frozen=True)
class Profile:
    """The result of timing a renderer."""

    timing: Timing
    # Use -> bytes on the device after all cameras were drawn. Buffers only grow, so each use has the bytes
    # that the most demanding camera needs, however fast the machine is.
    memory: Mapping[str, int]
    # Use -> its group (`Renderer.memory_groups`).
    memory_groups: Mapping[str, str]

    def to_dict(self) -> dict[str, Any]:
        """Return the profile as JSON data."""
        own = self.timing
        return {
            "frames": own.frames,
            "device_ms": {"p50": own.p50_ms, "p95": own.p95_ms, "mean": own.mean_ms},
            "busy_ms": {"p50": own.busy_p50_ms, "p95": own.busy_p95_ms},
            "queued_ms": {"p50": own.queued_p50_ms, "p95": own.queued_p95_ms},
            "stages_ms": own.stages_ms,
            "fps": own.fps,
            "round_fps": list(own.round_fps),
            "memory_bytes": dict(self.memory),
        }


def profile(
    renderer: Renderer,
    cameras: Sequence[Camera],
    background: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    frames: int = Options.frames,
    seconds: float = Options.seconds,
    warm_up: int | None = Options.warm_up,
    device_kind: Literal["gpu", "cpu", "other"] = "other",
    step: Callable[[], None] = lambda: None,
) -> Profile:
    """Return how fast a fresh `renderer` draws `cameras`, in turn and repeatedly.

    Timing goes on until `frames` and `seconds` are both reached. The warm-up is by default of 10 frames or
    one second, whichever ends first, but of as many frames as a renderer needs to settle. `device_kind` is of
    what draws, for the record. `step` is called after each timed frame.
    """
    if not cameras:
        raise ValueError("there is no camera to time")
    turns = _Turns(renderer, cameras, background)
    if warm_up is None:
        turns.repeat(WARM_UP_FRAMES, WARM_UP_SECONDS if frames > 1 else 0, any_of=True)
        if frames > 1 and turns.frames < SETTLED_AT:
            turns.repeat(SETTLED_AT - turns.frames, 0)
    elif warm_up:
        turns.repeat(warm_up, 0)
    start = time.perf_counter()
    turns.ends.clear()
    drawn = turns.repeat(frames, seconds, step=step)
    elapsed = time.perf_counter() - start
    ends = [start, *turns.ends]
    while turns.unseen:
        turns.draw(min(turns.unseen))
    spans = [one.span for one in drawn]
    p50, p95 = np.percentile(spans, (50, 95)).tolist()
    busy_p50, busy_p95 = np.percentile([sum(one.stages.values()) for one in drawn], (50, 95)).tolist()
    queued = [one.since_queued for one in drawn if one.since_queued is not None]
    queued_p50, queued_p95 = np.percentile(queued, (50, 95)).tolist() if queued else (None, None)
    names = dict.fromkeys(name for one in drawn for name in one.stages)
    fps = len(drawn) / elapsed
    timing = Timing(
        frames=len(drawn),
        seconds=len(drawn) / fps,
        fps=fps,
        p50_ms=p50,
        p95_ms=p95,
        mean_ms=float(np.mean(spans)),
        busy_p50_ms=busy_p50,
        busy_p95_ms=busy_p95,
        queued_p50_ms=queued_p50,
        queued_p95_ms=queued_p95,
        round_fps=_round_rates(ends),
        stages_ms={name: float(np.median([one.stages.get(name, 0.0) for one in drawn])) for name in names},
        device_kind=device_kind,
    )
    return Profile(timing, dict(renderer.memory()), dict(renderer.memory_groups()))


def _round_rates(ends: Sequence[float]) -> tuple[float, ...]:
    """Return the frame rates of up to `ROUNDS` rounds, from when the clock started and every frame ended."""
    frames = len(ends) - 1
    rounds = min(ROUNDS, frames)
    marks = [number * frames // rounds for number in range(rounds + 1)]
    return tuple((b - a) / (ends[b] - ends[a]) for a, b in pairwise(marks) if ends[b] > ends[a])


class _Turns:
    """Draws cameras, and knows which were not drawn since the renderer settled (`unseen`)."""

    def __init__(self, renderer: Renderer, cameras: Sequence[Camera], background: Sequence[float]) -> None:
        self.renderer, self.cameras, self.background = renderer, cameras, background
        self.frames = 0
        self.ends: list[float] = []
        self.unseen = set(range(len(cameras)))

    def draw(self, number: int) -> Drawn:
        """Draw the camera with this number."""
        self.frames += 1
        if self.frames >= SETTLED_AT:
            self.unseen.discard(number)
        return self.renderer.draw(self.cameras[number], self.background)

    def repeat(
        self,
        frames: int,
        seconds: float,
        *,
        any_of: bool = False,
        step: Callable[[], None] = lambda: None,
    ) -> list[Drawn]:
        """Draw in turn until `frames` and `seconds` are both reached, or either of them."""
        drawn: list[Drawn] = []
        start = time.perf_counter()
        while True:
            reached = (len(drawn) >= frames, time.perf_counter() - start >= seconds)
            if drawn and (any(reached) if any_of else all(reached)):
                return drawn
            drawn.append(self.draw(len(drawn) % len(self.cameras)))
            self.ends.append(time.perf_counter())
            step()
