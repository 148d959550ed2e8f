"""The deployment protocol: how fast and how large an asset is on a tier (`profile`)."""
