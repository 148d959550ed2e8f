"""The old name of `storage`."""

from msb.engines.dedicated_page.storage import store

__all__ = ["store"]
