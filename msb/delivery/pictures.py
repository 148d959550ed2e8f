"""The old name of `web_quality`."""

from msb.delivery.web_quality import ImageLoss as Pictures
from msb.delivery.web_quality import encode_and_read as written
from msb.delivery.web_quality import web_style

__all__ = ["Pictures", "web_style", "written"]
