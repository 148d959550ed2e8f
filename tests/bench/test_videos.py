"""Films of conditions side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from msb import metrics
from msb.bench.protocol import ProtocolFile
from msb.bench.protocol_tables import VideosTable
from msb.bench.run import run_protocol
from tests.bench.protocols import changed, planned

pytestmark = pytest.mark.slow


def frames(path: Path) -> list[NDArray[np.uint8]]:
    import av

    with av.open(str(path)) as film:
        return [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]


@pytest.mark.parametrize("path", ["flight", "test"])
def test_conditions_stand_side_by_side(again: ProtocolFile, path: str) -> None:
    options = VideosTable(path=path, frames=8, fps=8)
    file = changed(again, videos=options)
    only = ["two_dts/dedicated", "two_dts/standard"]
    assert set(planned(run_protocol(file, only=only)).values()) == {"done"}
    film = file.results / "videos" / "nerf_synthetic" / "pebble" / "two_dts.mp4"
    shown = frames(film)
    assert len(shown) == 8
    columns = 2 if path == "flight" else 3
    height, width = shown[0].shape[:2]
    assert height >= 240
    if path == "test":  # the photograph, then Dedicated, then Standard, each enlarged by whole pixels
        folder = next((file.results / "ground_truth").rglob("*.png")).parent
        photograph = metrics.read_image(sorted(folder.glob("*.png"))[0])
        assert width == columns * photograph.shape[1] * (height // photograph.shape[0])
        times = height // photograph.shape[0]
        enlarged = photograph.repeat(times, axis=0).repeat(times, axis=1)
        lower = height // 3  # below the title
        seen = shown[0][lower:, : enlarged.shape[1]].astype(float)
        assert np.abs(seen - enlarged[lower:]).mean() < 4
    part = width // columns
    first, last = (
        shown[0][:, number * part : (number + 1) * part].astype(float) for number in (-2, -1 % columns)
    )
    assert np.abs(first - last).mean() > 0.5, "the conditions differ"
    written = film.stat().st_mtime_ns
    run_protocol(file, only=only)
    assert film.stat().st_mtime_ns == written, "a film that holds is not made again"
