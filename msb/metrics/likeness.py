"""How alike two renderings of one thing look: two limits of PSNR in dB, which all judgements share."""

import math

# From here on the eye finds a difference only by flipping between the two.
ALIKE = 35.0
# Below this the difference is obvious side by side.
NEARLY = 25.0


def decibels(value: float) -> str:
    """Return "34.9 dB" of 34.998: rounded down, so that no limit seems to be reached that is not."""
    return f"{math.floor(10 * value + 1e-9) / 10:.1f} dB"
