"""The benchmark: image quality, speed, memory and structure of assets in the conditions of a protocol."""
