"""Films of conditions side by side."""

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
    assert not film.parent.with_suffix(".mp4").exists(), "one method needs no grid"
    written = film.stat().st_mtime_ns
    run_protocol(file, only=only)
    assert film.stat().st_mtime_ns == written, "a film that holds is not made again"


def test_the_methods_of_a_scene_stand_below_each_other(again: ProtocolFile) -> None:
    file = changed(again, videos=VideosTable(frames=4, fps=4))
    only = ["two_dts/dedicated", "two_dts/standard", "diffsoup/dedicated"]
    run_protocol(file, only=only)
    grid = file.results / "videos" / "nerf_synthetic" / "pebble.mp4"
    shown, own = frames(grid), frames(grid.with_suffix("") / "two_dts.mp4")
    assert len(shown) == 4
    height, width = own[0].shape[:2]
    assert shown[0].shape[:2] == (2 * height, width)
    two_dts, diffsoup = shown[0][:height].astype(float), shown[0][height:].astype(float)
    part = height * 3 // 4  # above the method's title
    assert np.abs(two_dts[:part] - own[0][:part]).mean() < 4
    assert diffsoup[:, : width // 2].std() > 5
    assert diffsoup[:, width // 2 + 8 :].max() < 20, "DiffSoup has no standard tier"
    written = grid.stat().st_mtime_ns
    run_protocol(file, only=only)
    assert grid.stat().st_mtime_ns == written
