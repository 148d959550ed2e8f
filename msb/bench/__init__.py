"""The benchmark: what images, speed, memory and structure an asset has under each condition of a protocol."""
