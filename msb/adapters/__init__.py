"""Read the files of a training and convert them to an asset, without torch."""
