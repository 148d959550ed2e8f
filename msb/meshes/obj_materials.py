"""Materials of OBJ files: the images and colours of MTL files are read as textures."""

import codecs
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_TEXTURES
from msb.errors import MeshFileError, shorten
from msb.meshes.images import MAX_FILE, Decoder, describe_lost_image
from msb.meshes.linked_files import read_linked_file, resolve_linked_path
from msb.meshes.mesh import Mesh
from msb.meshes.polygons import Triangulation
from msb.meshes.source import Source
from msb.meshes.text import Words, word_blocks

_STATEMENT = re.compile(rb"^[ \t]*(mtllib|usemtl)[ \t]+([^\n]*)", re.MULTILINE)
# The separator between library names, which may contain spaces.
_BETWEEN = re.compile(r"(?<=\.mtl)\s+", re.IGNORECASE)
# Limits that protect against malicious files. Total size of all MTL libraries: 16 MiB.
_MAX_LIBRARY_BYTES = 1 << 24
# Largest number of MTL libraries, and largest number of images.
_MAX_FILES = 1 << 10
# Longest `map_Kd` line in characters: the longest path in Linux.
_MAX_LINE = 1 << 12
_WHITE = (255, 255, 255)
# Map options with several arguments. The value is the largest number of arguments of the option. The options
# `-o`, `-s` and `-t` may have fewer arguments.
_OPTIONS = {"-o": 3, "-s": 3, "-t": 3, "-mm": 2}
# The values of map options that leave the image unchanged.
_NEUTRAL = {"-o": 0.0, "-t": 0.0, "-s": 1.0, "-clamp": "off", "-blendu": "on", "-blendv": "on"}
_NUMBER = re.compile(r"[+-]?(\d++\.?\d*+|\.\d++)(e[+-]?\d++)?", re.IGNORECASE)
_FURTHER_MAP = re.compile(r"map_\w+|bump|disp|decal|refl|norm")

# The first word of a comment that states the alpha cut-off of the next `map_d` line. The MTL format itself
# has no alpha cut-off.
CUTOFF = "alphaCutoff"
_CUTOFF = 0.5
LeftOut = dict[str, None]


@dataclass(frozen=True)
class _Image:
    """An image: its name in the MTL file, and whether its alpha channel cuts holes."""

    name: str
    is_masked: bool


# A material as an image, or as an sRGB colour in bytes.
Texture = _Image | tuple[int, ...]


@dataclass
class _Material:
    """A material: its sRGB colour in bytes, and the file names of its image and its opacity map."""

    color: tuple[int, ...] = _WHITE
    image: str | None = None
    mask: str | None = None
    cutoff: float = _CUTOFF

    @property
    def is_masked(self) -> bool:
        """Whether the alpha channel of the image cuts holes.

        The alpha channel cuts holes if the opacity map is the same file.
        """
        return self.image is not None and self.mask == self.image

    @property
    def texture(self) -> _Image | None:
        """The image of the material."""
        return None if self.image is None else _Image(self.image, self.is_masked)


def select_face_lines(words: Words) -> NDArray[np.bool_]:
    """Return a mask (L,) of the lines that define polygons."""
    return words.lines_beginning(b"f") | words.lines_beginning(b"fo")


def names_materials(text: Source) -> bool:
    """Return whether an OBJ file uses materials and names material libraries."""
    return {statement[1] for statement in _STATEMENT.finditer(text.data)} == {b"mtllib", b"usemtl"}


def with_materials(mesh: Mesh, text: Source, cut: Triangulation) -> tuple[Mesh, LeftOut]:
    """Return `mesh` with textures, and the names of unread data. The mesh was read from `text`.

    The argument `cut` is the triangulation of the polygons.

    A material is replaced by its image, or by a single texel of its colour. Libraries and images that cannot
    be read are skipped. A material without an image may lose its colour. The colour is lost if vertices have
    colours, or if there are more than `MAX_TEXTURES` colours.
    """
    # Collect the `usemtl` statements with their byte offsets, and the names of the libraries.
    known: dict[str, _Material] = {}
    left_out: LeftOut = {}
    uses: list[tuple[int, str]] = [(-1, "")]
    libraries: dict[str, None] = {}
    for statement in _STATEMENT.finditer(text.data):
        words = _decode_line(statement[2])
        if statement[1] == b"usemtl":
            uses.append((statement.start(), words))
        else:
            names = [name for name in _BETWEEN.split(words) if name.lower().endswith(".mtl")]
            libraries |= dict.fromkeys(names or [words])
    _read_libraries(text, libraries, known, left_out)
    unknown = next((name for _, name in uses[1:] if name not in known), "")
    if unknown and not any(part.startswith("materials (") for part in left_out):
        left_out[f"material {shorten(unknown, 60)} (not defined in any library)"] = None
    # Replace every used material by its image or its colour.
    used = {name: known.get(name, _Material()) for _, name in uses}
    found, images = _decode_images(text, used, left_out)
    textures: dict[str, Texture] = {}
    for name, material in used.items():
        image = material.texture
        textures[name] = material.color if image is None else found.get(image, material.color)
    distinct = set(textures.values())
    if (
        not images
        and distinct != {_WHITE}
        and (mesh.vertex_colors is not None or len(distinct) > MAX_TEXTURES)
    ):
        left_out["colours of materials"] = None
        distinct = {_WHITE}
    if distinct == {_WHITE}:
        return mesh, left_out
    mesh = _with_textures(mesh, text, cut, [(at, textures[name]) for at, name in uses], images)
    # If any image has an alpha channel, the mesh gets the smallest cut-off of all materials.
    if any(image.shape[2] == 4 for image in mesh.textures):
        cutoff = min(material.cutoff for material in used.values() if material.is_masked)
        mesh = replace(mesh, sampler=replace(mesh.sampler, alpha_cutoff=cutoff))
    return mesh, left_out


def with_coordinates(mesh: Mesh, text: Source, cut: Triangulation) -> Mesh:
    """Return `mesh` with texture coordinates at its corners. The mesh was read from `text`."""
    uvs, corners, _ = _read_coordinates(text)
    return replace(mesh, corner_uvs=uvs[corners[cut.order.reshape(-1)]])


def _with_textures(
    mesh: Mesh,
    text: Source,
    cut: Triangulation,
    uses: list[tuple[int, Texture]],
    images: dict[_Image, NDArray[np.uint8]],
) -> Mesh:
    """Return `mesh` with the textures of its materials.

    The argument `uses` lists the `usemtl` lines by byte offset, and their textures.
    """
    uvs, corners, lines = _read_coordinates(text)
    # A polygon has the texture of the last preceding `usemtl` line. Assign numbers to the textures that
    # polygons use.
    used = np.searchsorted([at for at, _ in uses], lines, side="right") - 1
    numbers: dict[Texture, int] = {}
    of_use = [numbers.setdefault(uses[use][1], len(numbers)) for use in np.unique(used).tolist()]
    if len(numbers) > MAX_TEXTURES:
        message = f"the file has {len(numbers)} textures and colours; at most {MAX_TEXTURES} are supported"
        raise text.error("MESH_FILE_TOO_LARGE", message)
    of_polygon = np.array(of_use, np.uint32)[np.unique(used, return_inverse=True)[1]]
    return replace(
        mesh,
        corner_uvs=uvs[corners[cut.order.reshape(-1)]],
        textures=tuple(
            images[texture] if isinstance(texture, _Image) else np.array([[texture]], np.uint8)
            for texture in numbers
        ),
        face_textures=of_polygon[cut.polygon] if len(numbers) > 1 else None,
    )


def _read_coordinates(
    text: Source,
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
    """Return three arrays: the texture coordinates of an OBJ file, the rows of the corners, and the offsets
    of the polygons.

    The first array has the texture coordinates (T + 1, 2), with v downwards. The last row of texture
    coordinates is for corners without coordinates. The second array (C,) has the coordinate row of each
    corner. The third array (P,) has the byte offset of each polygon.
    """
    uvs, corners, lines, above = [], [], [], 0
    for words in word_blocks(text, comments=True):
        is_uv, is_face = words.lines_beginning(b"vt"), select_face_lines(words)
        uvs.append(_read_uvs(words, is_uv))
        chosen = words.arguments(is_face)
        # A corner is "v", "v/vt", "v//vn" or "v/vt/vn". `named` is the index in the second part of a corner,
        # or -1 if this part is empty.
        named = words.after(b"/").without_suffix(b"/")
        has_uv = chosen & (named.end > named.start)
        rows = np.full(len(words.start), -1, np.int64)
        rows[has_uv] = named.indices(has_uv, above + np.cumsum(is_uv), "texture coordinate")
        corners.append(rows[chosen])
        lines.append(words.base + words.start[words.first[is_face]])
        above += int(is_uv.sum())
    joined = np.concatenate(corners)
    if joined.size and joined.max() >= above:
        message = f"a face uses texture coordinate {joined.max() + 1}, but the file has only {above}"
        raise text.error("MESH_FILE_INVALID", message)
    stored = np.concatenate([*uvs, np.zeros((1, 2))])
    with np.errstate(over="ignore"):
        return stored.astype(np.float32), joined, np.concatenate(lines)


def _read_uvs(words: Words, is_uv: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the texture coordinates (N, 2) of the lines selected by `is_uv` (L,), with v downwards."""
    widths = words.count[is_uv] - 1
    wrong = np.flatnonzero((widths < 1) | (widths > 3))
    if wrong.size:
        message = f"'vt' has {widths[wrong[0]]} numbers; it must have u, u v or u v w"
        raise words.line_error("MESH_FILE_INVALID", int(np.flatnonzero(is_uv)[wrong[0]]), message)
    values = words.numbers(words.arguments(is_uv))
    first = np.cumsum(widths) - widths
    uvs = np.zeros((len(widths), 2))
    uvs[:, 0] = values[first]
    uvs[widths > 1, 1] = values[first[widths > 1] + 1]
    uvs[:, 1] = 1 - uvs[:, 1]
    return uvs


def _decode_images(
    text: Source, used: dict[str, _Material], left_out: LeftOut
) -> tuple[dict[_Image, _Image], dict[_Image, NDArray[np.uint8]]]:
    """Return the images that can be read, and the texels of these images.

    A file with several names is read once. Each name of the file is mapped to the first name. The keys of the
    texels are these first names.
    """
    decoder, files, texels = Decoder(), set[Path](), {}
    firsts: dict[tuple[Path, bool], _Image] = {}
    first_of: dict[_Image, _Image] = {}
    for image in dict.fromkeys(material.texture for material in used.values()):
        if image is None:
            continue
        path = image.name.replace("\\", "/")
        try:
            place = resolve_linked_path(text, path, "map_Kd")
            if len(files | {place}) > _MAX_FILES:
                left_out[f"images after the first {_MAX_FILES:,}"] = None
                break
            files.add(place)
            first_of[image] = firsts.setdefault((place, image.is_masked), image)
            if first_of[image] == image:
                data = read_linked_file(text, path, "map_Kd", MAX_FILE)
                texels[image] = decoder.decode(data, alpha=image.is_masked)
        except MeshFileError as error:
            left_out[describe_lost_image(image.name, error.message)] = None
    return {image: first for image, first in first_of.items() if first in texels}, texels


def _read_libraries(
    text: Source, names: Iterable[str], known: dict[str, _Material], left_out: LeftOut
) -> None:
    """Add the materials of the libraries `names` to `known`.

    The first definition of a material name is used.
    """
    room = _MAX_LIBRARY_BYTES
    for number, name in enumerate(names):
        if number == _MAX_FILES:
            left_out[f"materials after the first {_MAX_FILES:,} files"] = None
            return
        try:
            data = read_linked_file(text, name.replace("\\", "/"), "mtllib", room)
        except MeshFileError as error:
            left_out[f"materials ({shorten(error.message, 200)})"] = None
            continue
        _read_library(data[:room], known, left_out)
        if len(data) > room:
            left_out[f"materials after the first {_MAX_LIBRARY_BYTES >> 20} MiB"] = None
            return
        room -= len(data)


def _read_library(data: bytes, known: dict[str, _Material], left_out: LeftOut) -> None:
    """Add the materials of an MTL file to `known`."""
    material, materials = _Material(), []
    cutoff = _CUTOFF
    for line in data.removeprefix(codecs.BOM_UTF8).splitlines():
        word, _, rest = _decode_line(line).partition(" ")
        rest = rest.strip()
        if word == "newmtl":
            material, cutoff = _Material(), _CUTOFF
            known.setdefault(rest, material)
            materials.append(material)
        elif word == "Kd":
            material.color = _parse_color(rest)
        elif word.lower() == "map_kd" and len(rest) > _MAX_LINE:
            left_out[f"an image with a name of more than {_MAX_LINE:,} characters"] = None
        elif word.lower() == "map_kd":
            material.image, is_plain = _strip_options(rest)
            if not is_plain:
                left_out["options of maps"] = None
        elif word == "#" and rest.startswith(CUTOFF):
            cutoff = _parse_cutoff(rest.removeprefix(CUTOFF).strip())
        elif word.lower() == "map_d" and len(rest) <= _MAX_LINE:
            material.mask, material.cutoff = _strip_options(rest)[0], cutoff
        elif _FURTHER_MAP.fullmatch(word.lower()):
            left_out["further maps of materials"] = None
    if any(material.mask is not None and not material.is_masked for material in materials):
        left_out["further maps of materials"] = None


def _parse_color(words: str) -> tuple[int, ...]:
    """Return the colour of a Kd line in bytes.

    A line without three numbers, such as a spectral curve, gives white.
    """
    values = words.split()[:3]
    if len(values) < 3 or not all(_NUMBER.fullmatch(value) for value in values):
        return _WHITE
    return tuple(round(255 * min(max(float(value), 0), 1)) for value in values)


def _parse_cutoff(word: str) -> float:
    """Return the alpha cut-off in a comment. Return the default if the text is not a positive number."""
    value = float(word) if len(word) < 40 and _NUMBER.fullmatch(word) else 0.0
    return value if 0 < value < float("inf") else _CUTOFF


def _strip_options(words: str) -> tuple[str, bool]:
    """Return the image name in a map_Kd line. Also return whether the options of the line leave the image
    unchanged."""
    is_plain = True
    while words.startswith("-"):
        option, _, words = words.partition(" ")
        for number in range(_OPTIONS.get(option, 1)):
            value, _, rest = words.lstrip().partition(" ")
            if number and not _NUMBER.fullmatch(value):
                break
            neutral = _NEUTRAL.get(option)
            is_number = isinstance(neutral, float) and _NUMBER.fullmatch(value)
            is_plain &= float(value) == neutral if is_number else value == neutral
            words = rest
        words = words.lstrip()
    return words, is_plain


def _decode_line(line: bytes) -> str:
    """Return a line as text. Lines that are not valid UTF-8 are decoded as Latin-1."""
    try:
        text = line.decode()
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    return " ".join(text.replace("\t", " ").split(" ")).strip()
