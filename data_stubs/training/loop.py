"""The training loop: random order of photographs, periodic changes of structure, progress and state."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from data_stubs.training.losses import Photograph
from data_stubs.training.model import Model, Statistics
from data_stubs.training.state import FILE, read_state, write_state
from msb import metrics
from msb.base.atomic import new_file
from msb.errors import UsageError

EVERY = 100
"""Iterations between changes of structure."""
_LINE_SECONDS, _STATE_SECONDS = 10.0, 120.0
_EVALUATIONS = 20
_NOTE = "optimised by our trainer with the method's image formation, not by its official training"


@dataclass(frozen=True)
class Length:
    """Length of a training: `minutes` or `iterations`.

    With `iterations`, the result does not depend on the machine.
    """

    minutes: float
    iterations: int | None

    def progress(self, iteration: int, seconds: float) -> float:
        """Return the share of the training that is done."""
        if self.iterations:
            return min(iteration / self.iterations, 1.0)
        return min(seconds / (60 * self.minutes), 1.0)


class Training:
    """A model in training; `folder` receives the official files, the state and the log."""

    def __init__(self, model: Model, length: Length, folder: Path, command: dict[str, Any]) -> None:
        self.model, self.length, self.folder = model, length, folder
        self.iteration, self.seconds = 0, 0.0
        self.log: list[dict[str, Any]] = []
        self.losses: list[float] = []
        self._about = {"command": command, "options": asdict(model.options), "method": model.method}
        self._views = [(camera, Photograph(torch.from_numpy(image))) for camera, image in model.capture.train]
        self._left: list[int] = []
        self._seen = Statistics(model.faces)

    def resume(self) -> None:
        """Continue the training stored in the folder."""
        arrays, about = read_state(self.folder / FILE)
        for name in ("method", "options"):
            if about.get(name) != self._about[name]:
                text = f"{self.folder / FILE} belongs to another training: its {name} is {about.get(name)}"
                raise UsageError("USAGE", text)
        try:
            self.model.restore(arrays)
            self.model.random.bit_generator.state = about["random"]
            self.iteration, self.seconds, self.log = about["iteration"], about["seconds"], about["log"]
            self._left = about["left"]
            self._seen = Statistics(self.model.faces)
            self._seen.peak, self._seen.error = arrays["seen/peak"], arrays["seen/error"]
        except (KeyError, TypeError, ValueError) as error:
            text = f"{self.folder / FILE} lacks data that --resume needs ({type(error).__name__}: {error})"
            raise UsageError("USAGE", text) from None

    @property
    def progress(self) -> float:
        """The share of the training that is done, from 0 to 1."""
        return self.length.progress(self.iteration, self.seconds)

    def run(self, stopped: Callable[[], bool]) -> None:
        """Train until the time is over or `stopped` returns true, then write everything."""
        said = saved = time.monotonic()
        last_evaluation = len(self.log) / _EVALUATIONS
        while self.progress < 1 and not stopped():
            start = time.monotonic()
            self.step()
            self.seconds += time.monotonic() - start
            now = time.monotonic()
            if now - said > _LINE_SECONDS:
                said = now
                self._say()
            if self.progress - last_evaluation >= 1 / _EVALUATIONS and self.progress < 1:
                last_evaluation = self.progress
                self._evaluate(self.model.settings(self.progress))
            if now - saved > _STATE_SECONDS:
                saved = now
                self.save()
        if self.progress >= 1 and self.losses:  # the list is empty if a finished training is resumed
            self._evaluate(self.model.settings(1.0))
        self.save()
        self.write()

    def step(self) -> None:
        """Do one iteration."""
        progress, model = self.progress, self.model
        if not self._left:
            self._left = model.random.permutation(len(self._views)).tolist()
        camera, photograph = self._views[self._left.pop()]
        loss, drawn = model.loss(camera, photograph, progress)
        loss.backward()
        self._seen.add(drawn, photograph)
        model.adam.step(model.rates(progress))
        self.losses.append(loss.item())
        self.iteration += 1
        # The structure changes only after every view has been used.
        if self.iteration % max(EVERY, len(self._views)) == 0:
            model.restructure(progress, self._seen)
            self._seen = Statistics(model.faces)

    def held_out(self, settings: dict[str, Any]) -> list[float]:
        """Return the PSNR of each test view in dB."""
        found = []
        with torch.no_grad():
            for camera, photograph in self.model.capture.test:
                image = self.model.draw(camera, settings).image.float().numpy()
                found.append(metrics.psnr(np.clip(image, 0, 1), photograph))
        return found

    def save(self) -> None:
        """Write the state and the log."""
        arrays = self.model.adam.state() | self.model.structure()
        arrays |= {"seen/peak": self._seen.peak, "seen/error": self._seen.error}
        about = self._about | {
            "random": self.model.random.bit_generator.state,
            "iteration": self.iteration,
            "seconds": self.seconds,
            "log": self.log,
            "left": self._left,
        }
        write_state(self.folder / FILE, arrays, about)
        document = {
            "note": _NOTE,
            **self._about,
            "iterations": self.iteration,
            "seconds": round(self.seconds, 1),
            "faces": self.model.faces,
            "psnr": self.log,
        }
        with new_file(self.folder / "training.json") as file:
            file.write(json.dumps(document, indent=1).encode() + b"\n")

    def write(self) -> None:
        """Write the official files."""
        self.model.write(self.folder, self.iteration, self.model.settings(self.progress))

    def _evaluate(self, settings: dict[str, Any]) -> None:
        values = self.held_out(settings)
        mean = round(sum(values) / len(values), 3) if values else None
        entry = {
            "iteration": self.iteration,
            "seconds": round(self.seconds, 1),
            "faces": self.model.faces,
            "loss": round(float(np.mean(self.losses[-len(self._views) :])), 5),
            "psnr": mean,
        }
        self.log.append(entry)
        self._say()

    def _say(self) -> None:
        left = self.seconds * (1 / max(self.progress, 1e-9) - 1)
        psnr = self.log[-1]["psnr"] if self.log else None
        recent = self.losses[-len(self._views) :]
        print(
            f"{100 * self.progress:5.1f} %  iteration {self.iteration:5d}  "
            f"{self.seconds / max(self.iteration, 1):.2f} s each  loss {np.mean(recent):.4f}  "
            f"held-out {'-' if psnr is None else format(psnr, '.2f')} dB  {self.model.faces} faces  "
            f"{left / 60:.1f} min left",
            file=sys.stderr,
            flush=True,
        )
