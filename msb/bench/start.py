"""What must be there before a run computes anything, so that a night is not lost for the lack of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from msb.base.extras import need_extra
from msb.base.files import regular_file
from msb.bench.quality import image_measures
from msb.errors import MsbError
from msb.metrics.registry import modules_needed

if TYPE_CHECKING:
    from msb.bench.protocol import ProtocolFile


def check_start(file: ProtocolFile, note: Callable[[str], None]) -> None:
    """Refuse to start a run that lacks an extra, or weights that its protocol names.

    `note` is called with what is to be known about the weights.
    """
    for check in _checks(file, note):
        check()


def wrong_at_start(file: ProtocolFile, note: Callable[[str], None]) -> list[MsbError]:
    """Return all for which `check_start` would refuse."""
    found: dict[str, MsbError] = {}
    for check in _checks(file, note):
        try:
            check()
        except MsbError as error:
            found.setdefault(str(error), error)
    return list(found.values())


def _checks(file: ProtocolFile, note: Callable[[str], None]) -> Iterator[Callable[[], object]]:
    weights = file.protocol.metrics.vgg_weights
    yield lambda: need_extra("bench", "filelock", *modules_needed(), what="a run")
    if file.protocol.videos is not None:
        yield lambda: need_extra("video", "av", what="[videos]")
    if weights is not None:
        place = file.resolve(weights)

        def load() -> None:
            for warning in image_measures(place).warnings:
                note(f"{warning.code}: {warning.message}")

        yield load
        yield lambda: regular_file(place)  # without the extra, loading does not come to look for the file
