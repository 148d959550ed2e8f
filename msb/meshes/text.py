"""Vectorised reading of words and numbers from text, block by block.

A file is cut into blocks of whole lines, so that the temporary arrays stay small whatever its size. Nothing
is decoded: names and comments may be in any encoding.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from msb.errors import MeshFileError, shorten
from msb.meshes.source import Source

# Bytes of text split into words at a time. The word tables take up to 30 times as much, about 130 MB.
BLOCK_BYTES = 1 << 22

# Numbers are parsed as float64, which holds every integer up to this one exactly.
EXACT_INTEGER = 2**53

_IS_SPACE = np.isin(np.arange(256), list(b" \t\n\r\v\f"))
_IS_FRACTION = np.isin(np.arange(256), list(b".eEnN"))
# No part gives back what it took: a million digits and a letter are refused at once.
_NUMBER = re.compile(rb"[+-]?((\d++\.?\d*+|\.\d++)(e[+-]?\d++)?|inf|infinity|nan(\(\w*+\))?)", re.IGNORECASE)


@dataclass(frozen=True)
class Words:
    """The words of a block of whole lines; T words in L lines that are not blank.

    Parameters
    ----------
    source : Source
        The file, for messages.
    base : int
        Byte number of the block's first byte.
    text : (B,) uint8
        The block; comments are blanked out.
    start, end : (T,) int64
        Where each word begins and ends in `text`.
    first : (L,) int64
        The first word of each line.
    count : (L,) int64
        The number of words of each line.
    """

    source: Source
    base: int
    text: NDArray[np.uint8]
    start: NDArray[np.int64]
    end: NDArray[np.int64]
    first: NDArray[np.int64]
    count: NDArray[np.int64]

    def lines_beginning(self, word: bytes) -> NDArray[np.bool_]:
        """Return which lines begin with `word`: (L,) bool."""
        start = self.start[self.first]
        lines = np.flatnonzero(self.end[self.first] - start == len(word))
        for at, byte in enumerate(word):
            lines = lines[self.text[start[lines] + at] == byte]
        mask = np.zeros(len(start), dtype=np.bool_)
        mask[lines] = True
        return mask

    def arguments(self, lines: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which words stand in the chosen lines after the first word: (T,) bool."""
        mask = np.repeat(lines, self.count)
        mask[self.first] = False
        return mask

    def without_suffix(self, separator: bytes) -> Words:
        """Return the same words, each cut before its first `separator` (one byte)."""
        return replace(self, end=np.minimum(self.end, self._next(separator)))

    def after(self, separator: bytes) -> Words:
        """Return the same words, each from after its first `separator` on (one byte); empty without one."""
        return replace(self, start=np.minimum(self._next(separator) + 1, self.end))

    def _next(self, separator: bytes) -> NDArray[np.int64]:
        """Return the place (T,) of the first `separator` from each word's beginning on."""
        places = np.flatnonzero(self.text == ord(separator))
        return np.append(places, len(self.text))[np.searchsorted(places, self.start)]

    def numbers(self, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the numbers the chosen words (T,) spell, each the nearest float64."""
        start, end = self.start[chosen], self.end[chosen]
        if not start.size:
            return np.zeros(0)
        edges = np.zeros(len(self.text) + 1, dtype=np.int8)
        edges[start] += 1
        edges[end] -= 1
        inside = np.cumsum(edges[:-1], dtype=np.int8).astype(np.bool_)
        values = _parse(np.where(inside, self.text, np.uint8(ord(" "))).tobytes())
        if values is None or values.size != start.size:
            raise self._bad_number(start, end)
        return values

    def indices(self, chosen: NDArray[np.bool_], above: NDArray[np.int64], of: str) -> NDArray[np.int64]:
        """Return the chosen words (T,) as indices `of` something in OBJ, from 0.

        In the file they begin with 1, or with -1 for the last of the `above` (L,) that stand before the line.
        """
        values = self.numbers(chosen)
        at = first_not_whole(values)
        why = "is not a whole number of at most 2**53"
        if at is None:
            made = values.astype(np.int64) - 1
            if (values < 0).any():
                made = np.where(values < 0, np.repeat(above, self.count)[chosen] + made + 1, made)
            if not (made < 0).any():
                return made
            at = int(np.argmax(made < 0))
            why = f"is not allowed: indices begin with 1, or with -1 for the {of} just above"
        byte = self.base + int(self.start[chosen][at])
        raise self.source.line_error("MESH_FILE_INVALID", byte, f"index {values[at]:.15g} {why}")

    def has_fraction(self) -> NDArray[np.bool_]:
        """Return which words are not written as a plain integer: (T,) bool."""
        seen = np.append(0, np.cumsum(_IS_FRACTION[self.text]))
        return seen[self.end] > seen[self.start]

    def line_error(self, code: str, line: int, message: str) -> MeshFileError:
        """Return the error about line number `line` of the L lines here."""
        byte = self.base + int(self.start[self.first[line]])
        return self.source.line_error(code, byte, message)

    def _bad_number(self, start: NDArray[np.int64], end: NDArray[np.int64]) -> MeshFileError:
        """Return the error about the first word that is not a number."""
        for first, last in zip(start.tolist(), end.tolist(), strict=True):
            word = self.text[first:last].tobytes()
            if not _NUMBER.fullmatch(word):
                shown = shorten(word.decode("latin-1"))
                text = f"'{shown}' is not a number"
                return self.source.line_error("MESH_FILE_INVALID", self.base + first, text)
        return self.source.error("MESH_FILE_INVALID", "a word is not a number")


def word_blocks(source: Source, start: int = 0, *, comments: bool = False) -> Iterator[Words]:
    """Yield the words of `source`, a text, from byte `start` on, about `BLOCK_BYTES` at a time.

    With `comments` "#" hides the rest of its line.
    """
    size = len(source.data)
    while start < size:
        line_end = source.data.find(b"\n", start + BLOCK_BYTES)
        end = size if line_end < 0 else line_end + 1
        yield _split(source, start, end, comments)
        start = end


@dataclass(frozen=True)
class Table:
    """All numbers of a stretch of text: T numbers in R lines that are not blank.

    Parameters
    ----------
    source : Source
        The file, for messages.
    values : (T,) float64
        The numbers.
    row : (R + 1,) int64
        Where each line's numbers begin in `values`, and T.
    byte : (R,) int64
        The byte number of each line's first word.
    has_fraction : (T,) bool
        Which numbers are not written as plain integers.
    """

    source: Source
    values: NDArray[np.float64]
    row: NDArray[np.int64]
    byte: NDArray[np.int64]
    has_fraction: NDArray[np.bool_]

    def row_error(self, code: str, row: int, message: str) -> MeshFileError:
        """Return the error about line number `row` of the R lines here."""
        return self.source.line_error(code, int(self.byte[row]), message)

    def integers(self, places: NDArray[np.int64], what: str) -> NDArray[np.int64]:
        """Return the integers at `places` of `values`, in the shape of `places`."""
        values = self.values[places]
        bad = first_not_whole(values.ravel())
        if bad is not None:
            row = int(np.searchsorted(self.row, places.ravel()[bad], side="right")) - 1
            text = f"{what} is {values.ravel()[bad]!s}, not a whole number of at most 2**53"
            raise self.row_error("MESH_FILE_INVALID", row, text)
        return values.astype(np.int64)


def read_table(source: Source, start: int, *, comments: bool = False) -> Table:
    """Return every number from byte `start` of the text `source` on; see `word_blocks`."""
    values, counts, places, fractions = [np.zeros(0)], [np.zeros(1, np.int64)], [np.zeros(0, np.int64)], []
    for words in word_blocks(source, start, comments=comments):
        values.append(words.numbers(np.ones(len(words.start), dtype=np.bool_)))
        counts.append(words.count)
        places.append(words.start[words.first] + words.base)
        fractions.append(words.has_fraction())
    return Table(
        source,
        np.concatenate(values),
        np.cumsum(np.concatenate(counts)),
        np.concatenate(places),
        np.concatenate(fractions) if fractions else np.zeros(0, dtype=np.bool_),
    )


def first_not_whole(values: NDArray[np.float64]) -> int | None:
    """Return the place of the first of `values` (T,) that is not an exact integer, or None."""
    bad = np.flatnonzero(~((values == np.floor(values)) & (np.abs(values) <= EXACT_INTEGER)))
    return int(bad[0]) if bad.size else None


def _split(source: Source, start: int, end: int, comments: bool) -> Words:
    """Return the words of bytes `start` to `end`, which are whole lines."""
    text = np.frombuffer(source.data, dtype=np.uint8, count=end - start, offset=start)
    line_end = text == ord("\n")
    if comments:
        text = _without_comments(text, line_end)
    space = np.ones(len(text) + 2, dtype=np.bool_)
    space[1:-1] = _IS_SPACE[text]
    edges = np.flatnonzero(space[1:] != space[:-1])
    begins = edges[0::2]
    line = np.cumsum(line_end, dtype=np.int32)[begins]
    first = np.flatnonzero(np.diff(line, prepend=-1))
    count = np.diff(first, append=len(begins))
    return Words(source, start, text, begins, edges[1::2], first, count)


def _without_comments(text: NDArray[np.uint8], line_end: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return `text` (B,) with everything from "#" to the end of its line blanked out."""
    marks = np.cumsum(text == ord("#"), dtype=np.int32)
    if not marks.size or not marks[-1]:
        return text
    before_line = np.maximum.accumulate(np.where(line_end, marks, 0))
    return np.where((marks > before_line) & ~line_end, np.uint8(ord(" ")), text)


def _parse(text: bytes) -> NDArray[np.float64] | None:
    """Return the numbers of `text`, which is not blank, or None where it holds anything else."""
    with warnings.catch_warnings():
        # Older NumPy warns where newer NumPy raises.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None
