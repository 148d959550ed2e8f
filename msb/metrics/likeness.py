"""Similarity of two renderings of one object: the PSNR limits in dB used by all verdicts."""

import math

# At this PSNR or above, differences are visible only when flipping between the images.
ALIKE = 35.0
# Below this PSNR, the difference is obvious side by side.
NEARLY = 25.0


def decibels(value: float) -> str:
    """Return a PSNR as text, such as "34.9 dB" for 34.998.

    The PSNR is rounded down, so that a value just below a limit is not printed as the limit.
    """
    return f"{math.floor(10 * value + 1e-9) / 10:.1f} dB"
