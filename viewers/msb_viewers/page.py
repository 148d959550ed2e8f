"""`msb view --html`: the viewer as a single HTML file for browsers with WebGL 2. pyvista is not needed."""

import base64
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import AMBIENT, GREY, light_toward
from msb.meshes.image_files import encode_image
from msb_viewers.camera import FOV_Y, default_pose
from msb_viewers.model import ViewModel
from msb_viewers.palette import BACKGROUND, HIGHLIGHT, NEUTRAL, SIZE_CLASSES, size_label
from msb_viewers.state import ViewState
from msb_viewers.template import build_page

# Number of faces above which the command prints a warning. A browser needs at least 48 bytes per face (3
# corners of 16 bytes). While the page loads, the browser needs twice as many bytes.
LARGE = 2_000_000


def write_page(
    model: ViewModel, path: Path, *, state: ViewState | None = None, up: str | None = None
) -> None:
    """Write the page of `model`. `state` and `up` have the same meaning as in `TopologyViewer`."""
    from msb.base.atomic import new_file

    with new_file(path) as file:
        file.write(page(model, state or ViewState.first(model), up or model.up))


def page(model: ViewModel, state: ViewState, up: str) -> bytes:
    """Return the page as UTF-8."""
    # All arrays are compressed into one block, and each array is aligned to 4 bytes.
    arrays = page_arrays(model)
    layout: dict[str, dict[str, Any]] = {}
    offset = 0
    for name, array in arrays.items():
        layout[name] = {"dtype": array.dtype.name, "offset": offset, "length": array.size}
        offset += -(-array.nbytes // 4) * 4
    packer = zlib.compressobj(6)
    packed = []
    for array in arrays.values():
        packed.append(packer.compress(np.ascontiguousarray(array).data))
        packed.append(packer.compress(bytes(-array.nbytes % 4)))
    packed.append(packer.flush())
    meta = {**_meta(model, state, up), "arrays": layout}
    return build_page("msb_viewers", meta, base64.b64encode(b"".join(packed)))


def page_arrays(model: ViewModel) -> dict[str, NDArray[Any]]:
    """Return the one-dimensional, little-endian arrays of the page by name."""
    # Faces with the same texture must be contiguous.
    rows = model.faces_of(None)
    textures = _by_texture(model)
    if textures:
        rows = np.concatenate([faces for _, faces in textures])
    arrays: dict[str, NDArray[Any]] = {
        "points": model.points.reshape(-1).astype("<f4", copy=False),
        "faces": model.faces[rows].reshape(-1).astype("<u4"),
        "size_class": model.size_class_of_faces()[rows],
    }
    if model.skin is not None:
        arrays["uvs"] = model.skin.textured.uvs[rows].reshape(-1).astype("<f4", copy=False)
        if model.skin.tint is not None:
            arrays["colors"] = model.skin.tint.reshape(-1, 12)[rows].reshape(-1)
        for number, _ in textures:
            image, sampler = model.skin.textured.images[number], model.skin.textured.sampler
            arrays[f"texture.{number}"] = np.frombuffer(encode_image(image, "png", sampler)[0], np.uint8)
    elif model.colors is not None:
        values = model.colors.values
        if model.colors.domain == "face":
            values = values[rows]
        elif model.colors.domain == "corner":
            values = values.reshape(-1, 9)[rows]
        arrays["colors"] = values.reshape(-1)
    if model.seams is not None:
        arrays["stored_rows"] = model.seams.first.astype("<u4")
    for kind, layer in model.layers.items():
        arrays[kind] = layer.vertices[model.rows(kind)].reshape(-1).astype("<u4")
    return arrays


def _by_texture(model: ViewModel) -> list[tuple[int, NDArray[Any]]]:
    """For each visible texture, return its index and its faces (n,)."""
    return [] if model.skin is None else model.skin.by_texture(model.faces_of(None))


def _skin(model: ViewModel) -> dict[str, Any] | None:
    """Return the properties of the textures that the page needs, without the texture images."""
    if model.skin is None:
        return None
    textures = [{"name": f"texture.{number}", "faces": len(rows)} for number, rows in _by_texture(model)]
    return {
        **asdict(model.skin.textured.sampler),
        "textures": textures,
        "tinted": model.skin.tint is not None,
        "cutoff": model.skin.cutoff,
    }


def _meta(model: ViewModel, state: ViewState, up: str) -> dict[str, Any]:
    """Return the data of the page that is not in arrays: texts, layers, colours and the first view."""
    from msb.topology.verdict import judge
    from msb_viewers.stage import median_edge

    counts = model.audit.judged.counts
    method = f"{model.method}: " if model.method else ""
    pose = default_pose(up, 1.0)
    sizes = {(group.low, group.high): group.components for group in model.size_classes()}
    classes = [{"label": "largest", "color": NEUTRAL, "components": min(len(model.sizes), 1)}]
    classes += [
        {"label": size_label(low, high), "color": color, "components": sizes.get((low, high), 0)}
        for low, high, color in SIZE_CLASSES
    ]
    return {
        "name": model.name,
        "subtitle": f"{method}{counts.vertices:,} vertices, {counts.faces:,} faces",
        "verdict": str(judge(model.audit)),
        "notes": list(model.notes),
        "colored": model.colors is not None,
        "domain": None if model.colors is None else model.colors.domain,
        "skin": _skin(model),
        "visible": sorted(state.visible),
        "active": state.active,
        "layers": [
            {**asdict(layer.style), "count": len(model.rows(kind)), "each": layer.vertices.shape[1]}
            for kind, layer in model.layers.items()
        ],
        "components": len(model.sizes),
        "classes": classes,
        "grey": [round(255 * GREY)] * 3,
        "daylight": {"dark": 1 - AMBIENT, "light": light_toward(model.up).tolist()},
        "background": BACKGROUND,
        "highlight": HIGHLIGHT,
        "direction": (pose.eye / np.linalg.norm(pose.eye)).tolist(),
        "up": pose.up.tolist(),
        "fov": FOV_Y,
        "extent": model.extent,
        "edge": median_edge(model),
        "center": model.center.tolist(),
        "scale": model.scale,
    }
