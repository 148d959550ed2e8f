"""Time a renderer: device time per frame, frame rate and memory over a set of cameras.

No file is written and no image is read back during the timing. On a slow machine, the timing may end before
every camera was drawn. The remaining cameras are drawn afterwards, so that the measured memory covers all
cameras.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from msb.bench.records import MOST_FRAME_TIMES, Timing
from msb.bench.timing import Timing as Options
from msb.render.backend import SETTLED_AT, DrawTime

if TYPE_CHECKING:
    from msb.render import Renderer
    from msb.scenes import Camera

# The default warm-up ends after this number of frames or after this time in seconds, whichever comes first.
WARM_UP_FRAMES = 10
WARM_UP_SECONDS = 1.0
# Number of consecutive rounds that divide the frames of a timing. If other programs use the machine, the
# rounds have different frame rates.
ROUNDS = 5


@dataclass(frozen=True)
class Profile:
    """The result of timing a renderer."""

    timing: Timing
    # For the name of each device buffer, its bytes after all cameras were drawn. Buffers never shrink, so
    # each buffer has the size that the largest view needs.
    memory: Mapping[str, int]
    # For the name of each device buffer, its group (`Renderer.memory_groups`).
    memory_groups: Mapping[str, str]

    def to_dict(self) -> dict[str, Any]:
        """Return the profile as JSON data. Device times are None if the renderer did not measure them."""
        timing = self.timing
        device = timing if timing.has_device_times else None

        def percentiles(kind: str, *names: str) -> dict[str, float | None]:
            return {name: getattr(device, f"{kind}{name}_ms", None) for name in names}

        return {
            "frames": timing.frames,
            "device_ms": percentiles("", "p50", "p95", "mean"),
            "busy_ms": percentiles("busy_", "p50", "p95"),
            "queued_ms": percentiles("queued_", "p50", "p95"),
            "stages_ms": timing.stages_ms,
            "fps": timing.fps,
            "round_fps": list(timing.round_fps),
            "frame_ms": list(timing.frame_ms) if device else [],
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
    """Time a new `renderer` that draws the `cameras` in turn, and return its times and memory.

    The timing ends when `frames` and `seconds` are both reached. The default warm-up (`warm_up` None) ends
    after 10 frames or one second. The warm-up has at least `SETTLED_AT` frames, because buffers may grow in
    the first frames. `device_kind` is stored in the result. `step` is called after each timed frame.
    """
    if not cameras:
        raise ValueError("cameras is empty; at least one camera is required")
    cycle = _CameraCycle(renderer, cameras, background)
    if warm_up is None:
        cycle.repeat(WARM_UP_FRAMES, WARM_UP_SECONDS if frames > 1 else 0, any_of=True)
        if frames > 1 and cycle.frames < SETTLED_AT:
            cycle.repeat(SETTLED_AT - cycle.frames, 0)
    elif warm_up:
        cycle.repeat(warm_up, 0)
    # The timed frames start here. Draw the remaining cameras only to measure memory.
    start = time.perf_counter()
    cycle.ends.clear()
    drawn = cycle.repeat(frames, seconds, step=step)
    elapsed = time.perf_counter() - start
    ends = [start, *cycle.ends]
    while cycle.unseen:
        cycle.draw(min(cycle.unseen))
    # Compute percentiles over all timed frames, and the median of each stage.
    spans = [frame.span for frame in drawn]
    p50, p95 = np.percentile(spans, (50, 95)).tolist()
    busy_p50, busy_p95 = np.percentile([sum(frame.stages.values()) for frame in drawn], (50, 95)).tolist()
    queued = [frame.since_queued for frame in drawn if frame.since_queued is not None]
    queued_p50, queued_p95 = np.percentile(queued, (50, 95)).tolist() if queued else (None, None)
    names = dict.fromkeys(name for frame in drawn for name in frame.stages)
    stages = {name: float(np.median([frame.stages.get(name, 0.0) for frame in drawn])) for name in names}
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
        round_fps=_compute_round_rates(ends),
        frame_ms=_select_frame_times(spans),
        stages_ms=stages,
        device_kind=device_kind,
    )
    return Profile(timing, dict(renderer.memory()), dict(renderer.memory_groups()))


def _compute_round_rates(ends: Sequence[float]) -> tuple[float, ...]:
    """Divide the frames into at most `ROUNDS` equal rounds, and return the frame rate of each round.

    `ends` holds the start of the timing and the end of every frame, in seconds.
    """
    frames = len(ends) - 1
    rounds = min(ROUNDS, frames)
    marks = [number * frames // rounds for number in range(rounds + 1)]
    return tuple((b - a) / (ends[b] - ends[a]) for a, b in pairwise(marks) if ends[b] > ends[a])


def _select_frame_times(spans: Sequence[float]) -> tuple[float, ...]:
    """Return the times of all frames in ms.

    If there are too many times for a record, return the times of evenly spread frames.
    """
    count = min(len(spans), MOST_FRAME_TIMES)
    return tuple(round(spans[number * len(spans) // count], 4) for number in range(count))


class _CameraCycle:
    """Draws cameras in turn.

    The set `unseen` contains the cameras that were not drawn yet. The remaining cameras are drawn later to
    measure memory.
    """

    def __init__(self, renderer: Renderer, cameras: Sequence[Camera], background: Sequence[float]) -> None:
        self.renderer, self.cameras, self.background = renderer, cameras, background
        self.frames = 0
        self.ends: list[float] = []
        self.unseen = set(range(len(cameras)))

    def draw(self, number: int) -> DrawTime:
        """Draw the camera with index `number`."""
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
    ) -> list[DrawTime]:
        """Draw the cameras in turn until `frames` and `seconds` are reached.

        If `any_of` is true, drawing ends when one of the two limits is reached.
        """
        drawn: list[DrawTime] = []
        start = time.perf_counter()
        while True:
            reached = (len(drawn) >= frames, time.perf_counter() - start >= seconds)
            if drawn and (any(reached) if any_of else all(reached)):
                return drawn
            drawn.append(self.draw(len(drawn) % len(self.cameras)))
            self.ends.append(time.perf_counter())
            step()
