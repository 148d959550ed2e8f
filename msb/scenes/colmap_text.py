"""The text format of COLMAP models: cameras.txt, images.txt, points3D.txt.

Layouts: `colmap/colmap`: doc/format.rst. Lines that begin with "#" are comments.
"""

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from msb.errors import shorten
from msb.scenes.colmap_models import MODELS, Lens, Shot, model_parameters
from msb.scenes.source import Source

# Longest accepted line in bytes. The line of an image with 100,000 2D points has about 5 MB.
MAX_LINE = 1 << 24
# Number of bytes of text that are split into lines in one step.
_BLOCK = 1 << 20
_MOST_WORDS = 4 + max(model.parameters for model in MODELS.values())
_INTEGER = re.compile(rb"[+-]?\d{1,18}")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def read_lenses(source: Source) -> Iterator[Lens]:
    """Yield the records of cameras.txt: ID MODEL WIDTH HEIGHT PARAMETERS..."""
    for line in filter(_Line.is_record, _lines(source)):
        words = line.text.split(None, _MOST_WORDS)
        if len(words) < 4:
            line.fail(f"a camera is ID MODEL WIDTH HEIGHT PARAMETERS; this line has {len(words)} words")
        name = words[1].decode("latin-1")
        with source.locating(line.pointer):
            wanted = model_parameters(name, name)
        if len(words) != 4 + wanted:
            line.fail(f"{name} has {wanted} parameters; this line has {len(words) - 4}")
        number, width, height = map(line.integer, (words[0], words[2], words[3]))
        yield Lens(number, name, width, height, tuple(map(line.number, words[4:])), line.pointer)


def count_shots(source: Source) -> int:
    """Return the number of images of images.txt, which has two lines per image."""
    lines = _lines(source)
    return sum(1 for line in lines if line.is_record() and next(lines, True))


def read_shots(source: Source) -> Iterator[Shot]:
    """Yield the records of images.txt: ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of 2D points.

    The second line of an image lists its 2D points and may be empty. The name of an image may contain spaces.
    """
    lines = _lines(source)
    for line in filter(_Line.is_record, lines):
        words = line.text.split(None, 9)
        if len(words) < 10:
            text = f"an image is ID QW QX QY QZ TX TY TZ CAMERA_ID NAME; this line has {len(words)} words"
            line.fail(text)
        number, lens = line.integer(words[0]), line.integer(words[8])
        values = tuple(map(line.number, words[1:8]))
        yield Shot(number, values[:4], values[4:], lens, words[9].strip(), line.pointer)
        points = next(lines, None)
        if points is not None and (count := points.word_count()) % 3:
            points.fail(
                f"the line has {count} words; the 2D points of the image above have three words each, "
                "and an image without points is followed by an empty line"
            )


def read_points(source: Source) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the positions and colours of points3D.txt: ID X Y Z R G B ERROR TRACK..."""
    values, places = array("d"), array("q")  # lists of numbers would need four times the memory
    for line in filter(_Line.is_record, _lines(source)):
        words = line.text.split(None, 8)
        if len(words) < 8:
            line.fail(f"a point is ID X Y Z R G B ERROR TRACK; this line has {len(words)} words")
        values.extend(line.numbers(words[1:7]))
        places.append(line.index)
    table = np.asarray(values).reshape(-1, 6)
    # Coordinates must be finite, and colours must be whole numbers from 0 to 255.
    colors = table[:, 3:]
    good = np.isfinite(table).all(axis=1) & ((colors >= 0) & (colors <= 255)).all(axis=1)
    good &= (colors == np.floor(colors)).all(axis=1)
    for row in np.flatnonzero(~good)[:1].tolist():
        excerpt = " ".join(f"{value:g}" for value in table[row])
        text = (
            f"the point is {excerpt}; it must have three finite coordinates and three colours from 0 to 255"
        )
        raise source.error("COLMAP_INVALID", text, pointer=f"line {places[row]}")
    return table[:, :3].copy(), colors.astype(np.uint8)


@dataclass(slots=True)
class _Line:
    """One line of a text file."""

    source: Source
    index: int
    text: bytes

    @property
    def pointer(self) -> str:
        return f"line {self.index}"

    def is_record(self) -> bool:
        """Return whether the line contains data, which is false for a blank line or a comment."""
        text = self.text.lstrip()
        return bool(text) and not text.startswith(b"#")

    def word_count(self) -> int:
        """Return the number of words.

        Do not split the line into words, because lists of 2D points are long.
        """
        dark = np.frombuffer(self.text, dtype=np.uint8) > ord(" ")
        return int(np.count_nonzero(dark[1:] & ~dark[:-1]) + np.count_nonzero(dark[:1]))

    def fail(self, message: str) -> NoReturn:
        """Raise COLMAP_INVALID for this line."""
        raise self.source.error("COLMAP_INVALID", message, pointer=self.pointer)

    def integer(self, word: bytes) -> int:
        """Return `word` as an integer."""
        if not _INTEGER.fullmatch(word):
            self._bad_number(word, "a whole number of at most 18 digits")
        return int(word)

    def number(self, word: bytes) -> float:
        """Return `word` as a floating-point number."""
        return self.numbers([word])[0]

    def numbers(self, words: list[bytes]) -> list[float]:
        """Return words as floats."""
        try:
            values = list(map(float, words))
        except ValueError:
            values = []
        if not values or b"_" in b"".join(words):  # Python's int() would accept 1_0 as 10
            self._bad_number(b" ".join(words), "a number" if len(words) == 1 else "a row of numbers")
        return values

    def _bad_number(self, text: bytes, wanted: str) -> NoReturn:
        excerpt = shorten(text.decode("latin-1"), 60)
        raise self.source.error("COLMAP_INVALID", f"'{excerpt}' is not {wanted}", pointer=self.pointer)


def _lines(source: Source) -> Iterator[_Line]:
    """Yield each line. The first line of the file has the number 1."""
    data, size = source.data, len(source.data)
    at = len(_BYTE_ORDER_MARK) if bytes(data[:3]) == _BYTE_ORDER_MARK else 0
    index = 0
    while at < size:
        end = data.find(b"\n", at + _BLOCK)
        end = size if end < 0 else end
        if end - at > _BLOCK + MAX_LINE:
            index += data[at : at + _BLOCK].count(b"\n") + 1
            text = f"the line is longer than {MAX_LINE} bytes"
            raise source.error("COLMAP_INVALID", text, pointer=f"line {index}")
        for index, line in enumerate(data[at:end].split(b"\n"), index + 1):  # noqa: B020 - continues the count
            yield _Line(source, index, line)
        at = end + 1
