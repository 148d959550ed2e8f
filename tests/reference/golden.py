"""The golden views: cameras and settings, and the buffers of the official kernels."""

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

import msb
from msb.reference import ReferenceFrame, render_reference
from msb.scenes import Camera
from tests.conftest import ROOT
from tests.golden.views import scenes, views

GOLDEN = ROOT / "tests" / "golden"


@dataclass(frozen=True, eq=False)
class View:
    """A golden view; `stored` has the official kernel's buffers, under their names without the prefix."""

    name: str
    folder: Path
    camera: Camera
    background: tuple[float, ...]
    settings: dict[str, Any]
    image: np.ndarray
    stable: np.ndarray | None
    stored: dict[str, Any]

    def render(self, dtype: type = np.float32, **overrides: Any) -> ReferenceFrame:
        settings = {**self.settings, **overrides}
        return render_reference(
            exported(self.folder / "checkpoint"), self.camera, self.background, settings, dtype
        )

    @cached_property
    def frame(self) -> ReferenceFrame:
        return self.render()

    @cached_property
    def viewer(self) -> dict[str, Any]:
        """The images of DiffSoup's official viewer."""
        return arrays_of(self.folder / "viewer_views.npz", f"v{self.name.partition('/')[2]}_")

    @property
    def web(self) -> msb.Asset:
        """The official web export of DiffSoup's model."""
        return exported(self.folder / "web_export" / self.folder.name)

    def kernel_rows(self, image: np.ndarray) -> np.ndarray:
        """Return an image in the row order of DiffSoup's kernels."""
        return image[::-1] if self.stored["flip_rows"] else image


@cache
def exported(path: Path) -> msb.Asset:
    return msb.export(path)


def arrays_of(path: Path, prefix: str) -> dict[str, Any]:
    with np.load(path) as file:
        return {key.removeprefix(prefix): file[key] for key in file.files if key.startswith(prefix)}


@cache
def golden_views(method: str) -> list[View]:
    golden = []
    for folder in scenes(GOLDEN, method):
        for number, (name, camera, background, settings, image, ok) in enumerate(views(folder, method)):
            prefix = f"cam{number}_" if method == "triangle_splatting" else f"v{number}_"
            stored = arrays_of(folder / "views.npz", prefix)
            golden.append(View(name, folder, Camera(**camera), background, settings, image, ok, stored))
    return golden


def names(view: View) -> str:
    return view.name


def psnr(image: np.ndarray, wanted: np.ndarray) -> float:
    """Return the PSNR in dB for a peak of 1, which is infinite for equal images."""
    error = float(np.square(image.astype(np.float64) - wanted).mean())
    return float("inf") if error == 0 else -10 * float(np.log10(error))


def worst(values: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest absolute difference."""
    return float(np.abs(np.asarray(values, np.float64) - wanted).max())
