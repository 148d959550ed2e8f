"""How alike two renderings of one thing look: two limits of PSNR in dB, which all judgements share."""

from __future__ import annotations

ALIKE = 35.0
"""From here on the eye finds a difference only by flipping between the two."""
NEARLY = 25.0
"""Below this the difference is obvious side by side."""
