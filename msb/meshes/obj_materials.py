"""Materials of OBJ: the images and colours of MTL files, as textures."""

import codecs
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_TEXTURES
from msb.errors import MeshFileError, shorten
from msb.meshes.beside import place_beside, read_beside
from msb.meshes.images import MAX_FILE, Decoder
from msb.meshes.mesh import Mesh
from msb.meshes.polygons import fan_triangulate
from msb.meshes.source import Source
from msb.meshes.text import Words, word_blocks

_STATEMENT = re.compile(rb"^[ \t]*(mtllib|usemtl)[ \t]+([^\n]*)", re.MULTILINE)
# What stands between the names of libraries, which may have spaces in them.
_BETWEEN = re.compile(r"(?<=\.mtl)\s+", re.IGNORECASE)
# Bytes of all libraries together.
_MAX_LIBRARIES = 1 << 24
# Libraries that are looked for, and images.
_MAX_FILES = 1 << 10
# Characters of a line map_Kd, as many as the path of a file has.
_MAX_WORDS = 1 << 12
_WHITE = (255, 255, 255)
# Options of a map with more than one argument; `-o`, `-s` and `-t` may have fewer than three.
_OPTIONS = {"-o": 3, "-s": 3, "-t": 3, "-mm": 2}
_NEUTRAL = {"-o": 0.0, "-t": 0.0, "-s": 1.0, "-clamp": "off", "-blendu": "on", "-blendv": "on"}
_NUMBER = re.compile(r"[+-]?(\d++\.?\d*+|\.\d++)(e[+-]?\d++)?", re.IGNORECASE)
_FURTHER_MAP = re.compile(r"map_\w+|bump|disp|decal|refl|norm")

# The name of an image as the file has it, or a colour in bytes of sRGB.
Texture = str | tuple[int, ...]
LeftOut = dict[str, None]


@dataclass
class _Material:
    color: tuple[int, ...] = _WHITE
    image: str | None = None


def face_lines(words: Words) -> NDArray[np.bool_]:
    """Return which lines are polygons: (L,) bool."""
    return words.lines_beginning(b"f") | words.lines_beginning(b"fo")


def names_materials(text: Source) -> bool:
    """Return whether an OBJ file uses materials and names the files of them."""
    return {each[1] for each in _STATEMENT.finditer(text.data)} == {b"mtllib", b"usemtl"}


def with_materials(mesh: Mesh, text: Source) -> tuple[Mesh, LeftOut]:
    """Return `mesh`, read from `text`, with textures of its materials, and what is left out of these.

    A material is its image, or a texel of its colour. A file or an image that cannot be read is left out, and
    so are colours, if nothing has an image, where vertices have some and where there are very many.
    """
    found: dict[str, _Material] = {}
    left_out: LeftOut = {}
    uses: list[tuple[int, str]] = [(-1, "")]
    libraries: dict[str, None] = {}
    for statement in _STATEMENT.finditer(text.data):
        words = _decoded(statement[2])
        if statement[1] == b"usemtl":
            uses.append((statement.start(), words))
        else:
            names = [name for name in _BETWEEN.split(words) if name.lower().endswith(".mtl")]
            libraries |= dict.fromkeys(names or [words])
    _read_libraries(text, libraries, found, left_out)
    unknown = next((name for _, name in uses[1:] if name not in found), "")
    if unknown and not any(each.startswith("materials (") for each in left_out):
        left_out[f"material {shorten(unknown, 60)} (no file of materials has it)"] = None
    shown = {name: found.get(name, _Material()) for _, name in uses}
    images = _images(text, shown, left_out)
    textures = {name: each.image if each.image in images else each.color for name, each in shown.items()}
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
    return _with_textures(mesh, text, [(at, textures[name]) for at, name in uses], images), left_out


def with_coordinates(mesh: Mesh, text: Source) -> Mesh:
    """Return `mesh` with the texture coordinates of its corners."""
    uvs, corners, counts, _ = _coordinates(text)
    triangles, _ = fan_triangulate(corners, counts)
    return replace(mesh, corner_uvs=uvs[triangles.reshape(-1)])


def _with_textures(
    mesh: Mesh, text: Source, uses: list[tuple[int, Texture]], images: dict[str, NDArray[np.uint8]]
) -> Mesh:
    """Return `mesh` with what its faces show from each byte of the file on."""
    uvs, corners, counts, lines = _coordinates(text)
    triangles, polygon = fan_triangulate(corners, counts)
    used = np.searchsorted([at for at, _ in uses], lines, side="right") - 1
    numbers: dict[Texture, int] = {}
    of_use = [numbers.setdefault(uses[use][1], len(numbers)) for use in np.unique(used).tolist()]
    if len(numbers) > MAX_TEXTURES:
        what = (
            f"the file shows {len(numbers)} textures and colours; {MAX_TEXTURES} are the most a mesh has here"
        )
        raise text.error("MESH_FILE_TOO_LARGE", what)
    of_polygon = np.array(of_use, np.uint32)[np.unique(used, return_inverse=True)[1]]
    return replace(
        mesh,
        corner_uvs=uvs[triangles.reshape(-1)],
        textures=tuple(
            images[each] if isinstance(each, str) else np.array([[each]], np.uint8) for each in numbers
        ),
        face_textures=of_polygon[polygon] if len(numbers) > 1 else None,
    )


def _coordinates(
    text: Source,
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return what the polygons have of texture coordinates.

    These are (T + 1, 2), v downwards, the last of which stands for none; which of them the corners (C,) have;
    how many corners each polygon has (P,), and the byte at which it begins.
    """
    uvs, corners, counts, lines, above = [], [], [], [], 0
    for words in word_blocks(text, comments=True):
        is_uv, is_face = words.lines_beginning(b"vt"), face_lines(words)
        uvs.append(_uvs(words, is_uv))
        chosen = words.arguments(is_face)
        named = words.after(b"/").without_suffix(b"/")
        has = chosen & (named.end > named.start)
        of_words = np.full(len(words.start), -1, np.int64)
        of_words[has] = named.indices(has, above + np.cumsum(is_uv), "texture coordinate")
        corners.append(of_words[chosen])
        counts.append(words.count[is_face] - 1)
        lines.append(words.base + words.start[words.first[is_face]])
        above += int(is_uv.sum())
    joined = np.concatenate(corners)
    if joined.size and joined.max() >= above:
        what = f"a face names texture coordinate {joined.max() + 1}; the file has {above}"
        raise text.error("MESH_FILE_INVALID", what)
    stored = np.concatenate([*uvs, np.zeros((1, 2))])
    with np.errstate(over="ignore"):
        return stored.astype(np.float32), joined, np.concatenate(counts), np.concatenate(lines)


def _uvs(words: Words, is_uv: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the texture coordinates (N, 2) of the `is_uv` (L,) lines, with v downwards."""
    widths = words.count[is_uv] - 1
    wrong = np.flatnonzero((widths < 1) | (widths > 3))
    if wrong.size:
        what = f"'vt' has {widths[wrong[0]]} numbers; u, u v or u v w is right"
        raise words.line_error("MESH_FILE_INVALID", int(np.flatnonzero(is_uv)[wrong[0]]), what)
    values = words.numbers(words.arguments(is_uv))
    first = np.cumsum(widths) - widths
    made = np.zeros((len(widths), 2))
    made[:, 0] = values[first]
    made[widths > 1, 1] = values[first[widths > 1] + 1]
    made[:, 1] = 1 - made[:, 1]
    return made


def _images(text: Source, shown: dict[str, _Material], left_out: LeftOut) -> dict[str, NDArray[np.uint8]]:
    """Return the texels of the images of materials by name; names of one file become the first of them."""
    decoder, images = Decoder(), {}
    firsts: dict[Path, str] = {}
    first_of: dict[str, str] = {}
    for name in dict.fromkeys(each.image for each in shown.values() if each.image is not None):
        if len(firsts) == _MAX_FILES:
            left_out[f"images beyond {_MAX_FILES:,}"] = None
            break
        path = name.replace("\\", "/")
        try:
            place = place_beside(text, path, "map_Kd")
            first_of[name] = firsts.setdefault(place, name)
            if first_of[name] == name:
                images[name] = decoder.decode(read_beside(text, path, "map_Kd", MAX_FILE), alpha=False)
        except MeshFileError as error:
            left_out[f"image {shorten(name, 60)} ({shorten(error.message, 200)})"] = None
    for material in shown.values():
        material.image = first_of.get(material.image or "")
    return images


def _read_libraries(
    text: Source, names: Iterable[str], found: dict[str, _Material], left_out: LeftOut
) -> None:
    """Add the materials of the files `names` to those `found`; the first of a name counts."""
    room = _MAX_LIBRARIES
    for number, name in enumerate(names):
        if number == _MAX_FILES:
            left_out[f"materials beyond {_MAX_FILES:,} files"] = None
            return
        try:
            data = read_beside(text, name.replace("\\", "/"), "mtllib", room)
        except MeshFileError as error:
            left_out[f"materials ({shorten(error.message, 200)})"] = None
            continue
        _read_library(data[:room], found, left_out)
        if len(data) > room:
            left_out[f"materials beyond {_MAX_LIBRARIES >> 20} MiB of files"] = None
            return
        room -= len(data)


def _read_library(data: bytes, found: dict[str, _Material], left_out: LeftOut) -> None:
    material = _Material()
    for line in data.removeprefix(codecs.BOM_UTF8).splitlines():
        word, _, rest = _decoded(line).partition(" ")
        rest = rest.strip()
        if word == "newmtl":
            material = _Material()
            found.setdefault(rest, material)
        elif word == "Kd":
            material.color = _color(rest)
        elif word.lower() == "map_kd" and len(rest) > _MAX_WORDS:
            left_out[f"an image whose name has more than {_MAX_WORDS:,} letters"] = None
        elif word.lower() == "map_kd":
            material.image, is_plain = _without_options(rest)
            if not is_plain:
                left_out["options of maps"] = None
        elif _FURTHER_MAP.fullmatch(word.lower()):
            left_out["further maps of materials"] = None


def _color(words: str) -> tuple[int, ...]:
    """Return the colour of a line Kd in bytes; white where it is no three numbers (a spectral curve)."""
    values = words.split()[:3]
    if len(values) < 3 or not all(_NUMBER.fullmatch(each) for each in values):
        return _WHITE
    return tuple(round(255 * min(max(float(each), 0), 1)) for each in values)


def _without_options(words: str) -> tuple[str, bool]:
    """Return the name of the image in a line map_Kd, and whether its options leave the image as it is."""
    is_plain = True
    while words.startswith("-"):
        option, _, words = words.partition(" ")
        for number in range(_OPTIONS.get(option, 1)):
            value, _, rest = words.lstrip().partition(" ")
            if number and not _NUMBER.fullmatch(value):
                break
            wanted = _NEUTRAL.get(option)
            is_number = isinstance(wanted, float) and _NUMBER.fullmatch(value)
            is_plain &= float(value) == wanted if is_number else value == wanted
            words = rest
        words = words.lstrip()
    return words, is_plain


def _decoded(line: bytes) -> str:
    """Return the words of a line; names are UTF-8, or else Latin-1."""
    try:
        text = line.decode()
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    return " ".join(text.replace("\t", " ").split(" ")).strip()
