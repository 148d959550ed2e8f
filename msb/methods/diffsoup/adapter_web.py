"""Read DiffSoup's web export: mesh.ply, the lattices as two PNGs, the MLP as JSON, and meta.json.

Layout: kenji-tojo/diffsoup at c74e35d (examples/06_export_web.py).
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.adapters.locate import Place
from msb.adapters.model import Content, Model, Options, Settings
from msb.asset.strict_json import MAX_BYTES, parse_strict_json
from msb.base.files import read_file
from msb.errors import CheckpointError, Finding, InputError, finding
from msb.meshes.assets import make_mesh_buffers
from msb.meshes.files import read_mesh
from msb.methods.diffsoup import MAX_LEVEL, METHOD, samples
from msb.methods.diffsoup.adapter import DECODER, describe, direction, domains

# Largest width of a look-up texture, in texels.
MAX_WIDTH = 4096
# Maps each key in mlp_weights.json to a key of the state dict. In the JSON file, weights are flat lists in
# the order [out][in].
WEIGHTS = dict(zip(("W1", "b1", "W2", "b2", "W3", "b3"), DECODER, strict=True))


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the model in the folder of `place`.

    Features and opacity stay bytes, as in the textures. A byte v represents v / 255.
    """
    folder = place.file.parent
    for name in METHOD.bundle:
        if not (folder / name).is_file():
            text = f"{name} is missing; the web export of DiffSoup contains it beside mesh.ply"
            raise CheckpointError("CHECKPOINT_FILE_MISSING", text, file=folder, pointer=name)
    buffers, _, _, origin = make_mesh_buffers(read_mesh(place.file))
    buffers.pop("color", None)
    faces = len(buffers["indices"])
    if not faces:
        raise CheckpointError("CHECKPOINT_DAMAGED", "the model is empty: it has no faces", file=place.file)
    texels, level = _read_textures(folder, faces)
    buffers["features.lattice"] = np.concatenate([texels[0], texels[1][:, :, :3]], axis=2)
    buffers["features.opacity"] = np.ascontiguousarray(texels[1][:, :, 3])
    buffers.update(_read_weights(folder / "mlp_weights.json"))
    meta, warnings = _read_meta(folder / "meta.json", faces, level)
    settings = Settings("diffsoup", options.settings)
    white = meta.get("background") == [1, 1, 1]
    settings.add("layout", "synthetic" if white else "colmap", "config" if meta else "default")
    description = replace(describe(settings, level, direction(meta.get("up")), "lut"), origin=origin)
    files = tuple(folder / name for name in (*METHOD.bundle, *(["meta.json"] if meta else [])))
    return Model(buffers, domains(buffers), description, place.root, files, tuple(warnings))


def texture_size(texels: int) -> tuple[int, int]:
    """Return width and height of a texture for a number of texels."""
    width = min(MAX_WIDTH, texels)
    return width, -(-texels // width)


def _read_textures(folder: Path, faces: int) -> tuple[list[NDArray[np.uint8]], int]:
    """Return both textures as arrays (faces, samples, 4), and the lattice level."""
    images = [_read_png(folder / name, faces) for name in ("lut0.png", "lut1.png")]
    sizes = {texture_size(faces * samples(level)): level for level in range(MAX_LEVEL, -1, -1)}
    height, width = images[0].shape[:2]
    if images[1].shape != images[0].shape:
        text = f"lut1.png is {images[1].shape[1]} x {images[1].shape[0]}, but lut0.png is {width} x {height}"
        raise CheckpointError("CHECKPOINT_DAMAGED", text, file=folder, pointer="lut1.png")
    level = sizes[width, height]
    used = faces * samples(level)
    return [image.reshape(-1, 4)[:used].reshape(faces, -1, 4) for image in images], level


def _read_png(path: Path, faces: int) -> NDArray[np.uint8]:
    """Return the pixels of an RGBA PNG, after checking its size."""
    from PIL import Image

    sizes = {texture_size(faces * samples(level)) for level in range(MAX_LEVEL + 1)}

    def error(why: str) -> CheckpointError:
        text = f"{path.name} {why}"
        return CheckpointError("CHECKPOINT_DAMAGED", text, file=path.parent, pointer=path.name)

    # disable Pillow's size limit; the code below checks the size
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with Image.open(path, formats=("PNG",)) as image:
            if image.mode != "RGBA":
                raise error(f"has mode {image.mode}; look-up textures must be RGBA with 8 bits per channel")
            if image.size not in sizes:
                valid = ", ".join(f"{w} x {h}" for w, h in sorted(sizes))
                width, height = image.size
                raise error(f"is {width} x {height}; {faces} faces need one of these sizes: {valid}")
            image.verify()  # verify the checksums, after which Pillow must open the file again
        with Image.open(path, formats=("PNG",)) as image:
            return np.asarray(image)
    except CheckpointError:
        raise
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError):  # Pillow's errors for broken PNGs
        raise error("is not a complete PNG") from None
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _read_weights(path: Path) -> dict[str, NDArray[np.float32]]:
    """Return the decoder's buffers from mlp_weights.json."""
    data = _read_json(path)
    buffers = {}
    for key, name in WEIGHTS.items():
        shape = DECODER[name]
        values, count = data.get(key), int(np.prod(shape))
        if not isinstance(values, list) or len(values) != count or not _are_numbers(values):
            text = f'{path.name}: "{key}" must be a list of {count} numbers'
            raise CheckpointError("CHECKPOINT_DAMAGED", text, file=path.parent, pointer=f"/{key}")
        with np.errstate(over="ignore"):
            array = np.array(values, np.float64).astype(np.float32).reshape(shape)
        if not np.isfinite(array).all():
            text = f'{path.name}: "{key}" contains numbers that do not fit into float32'
            raise CheckpointError("CHECKPOINT_DAMAGED", text, file=path.parent, pointer=f"/{key}")
        buffers[f"decoder.{name}"] = array
    return buffers


def _are_numbers(values: list[Any]) -> bool:
    return all(type(value) in (int, float) for value in values)


def _read_meta(path: Path, faces: int, level: int) -> tuple[dict[str, Any], list[Finding]]:
    """Return the content of meta.json, and a warning if it is missing."""
    if not path.is_file():
        text = "meta.json is missing: layout and up axis are defaults; set the layout with --set layout=L"
        return {}, [finding("CHECKPOINT_CONFIG_MISSING", text, severity="warning", file=str(path.parent))]
    data = _read_json(path)
    for key, expected in (("num_faces", faces), ("level", level)):
        if data.get(key, expected) != expected:
            text = f"meta.json: {key} is {data[key]!r:.40}, but mesh.ply and the textures have {expected}"
            raise CheckpointError("CHECKPOINT_DAMAGED", text, file=path.parent, pointer=f"/{key}")
    return data, []


def _read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in the file `path`."""
    about: dict[str, Any] = {"error": CheckpointError, "code": "CHECKPOINT_DAMAGED"}
    try:
        content = read_file(path, MAX_BYTES)
    except InputError as error:
        message = f"{path.name}: {error.message}"
        raise CheckpointError("CHECKPOINT_DAMAGED", message, file=path.parent) from error
    data = parse_strict_json(content, file=path.parent, name=path.name, **about)
    if not isinstance(data, dict):
        text = f"{path.name} does not contain a JSON object"
        raise CheckpointError("CHECKPOINT_DAMAGED", text, file=path.parent)
    return data
