"""Wrong arguments of trials are errors of usage."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.trial import Limits


@pytest.mark.parametrize("given", [(-1,), (1, np.nan)])
def test_limits_must_be_positive(given: tuple[Any, ...]) -> None:
    with pytest.raises(msb.MsbError) as caught:
        Limits(*given)
    assert caught.value.code == "USAGE"


def test_cameras_must_be_cameras(demo_asset: Path) -> None:
    cameras: Any = 3
    with pytest.raises(msb.MsbError) as caught:
        msb.trial(msb.open(demo_asset), ["uv"], cameras=cameras)
    assert caught.value.code == "USAGE"
