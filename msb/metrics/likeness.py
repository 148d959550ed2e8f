"""Similarity of two renderings of one object: the PSNR limits in dB used by all verdicts."""

import math

# At this PSNR or above, differences are visible only when a viewer switches between the two images.
ALIKE = 35.0
# Below this PSNR, the difference is obvious when the images are side by side.
NEARLY = 25.0


def decibels(value: float) -> str:
    """Return a PSNR as text, such as "34.9 dB" for 34.998.

    The PSNR is rounded down. Without rounding down, a value just below a limit would be printed as the limit.
    """
    return f"{math.floor(10 * value + 1e-9) / 10:.1f} dB"
