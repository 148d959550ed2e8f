"""The child process of a trial: it builds and runs trial.cl on one device and prints the result."""

from __future__ import annotations

import json
import sys

import numpy as np

from msb.cl import mend
from msb.cl.device import Device
from msb.cl.devices import found_devices
from msb.cl.loader import opencl
from msb.cl.trial import ANSWER
from msb.errors import DeviceError

_COUNT = 64


def answer(selector: str, *, mended: bool) -> None:
    """Print for the parent process why the device does not work, or null."""
    cl = opencl()
    why: str | None = f"{selector} is not there in a process of its own"
    for record, handle in found_devices(cl):
        if record.selector == selector:
            if mended and not mend.mend(handle):
                why = "its compiler's processor could not be named"
                break
            try:
                with Device(cl, handle, record) as device:
                    why = None if _is_right(device) else "it computes a small kernel wrongly"
            except DeviceError as error:
                why = error.message
            break
    print(ANSWER + json.dumps(why), flush=True)  # noqa: T201 - to the parent


def _is_right(device: Device) -> bool:
    given = (np.arange(8 * _COUNT, dtype=np.float32) / 16).reshape(_COUNT, 8)
    found = device.allocate(given.shape, np.float32)
    rounded = device.allocate(given.shape, np.int32)
    program = device.program("trial")
    program.trial(_COUNT, 1, device.upload(given), found, rounded, np.uint32(_COUNT))
    wanted = np.maximum(np.sqrt(given), 1) / 2
    return bool(
        np.allclose(found.read(), wanted, rtol=1e-6, atol=0)
        and (rounded.read() == given.astype(np.int32) - (given > 4)).all()
    )


if __name__ == "__main__":
    answer(sys.argv[1], mended=sys.argv[2] == "1")
