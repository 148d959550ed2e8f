"""Vectorised parsing of words and numbers in text files, block by block.

A file is split into blocks of whole lines, so that temporary arrays stay small for large files. Names and
comments may have any encoding, so bytes are not decoded.
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

# Number of bytes of text per block. The word tables of a block need up to 30 times as much memory, about 130
# MB.
BLOCK_BYTES = 1 << 22

# Numbers are parsed as float64. A float64 represents every integer up to this limit exactly.
EXACT_INTEGER = 2**53

_IS_SPACE = np.isin(np.arange(256), list(b" \t\n\r\v\f"))
_IS_FRACTION = np.isin(np.arange(256), list(b".eEnN"))
# A number. The possessive quantifiers (++, *+) never backtrack. A million digits with a letter at the end are
# therefore rejected in linear time.
_NUMBER = re.compile(rb"[+-]?((\d++\.?\d*+|\.\d++)(e[+-]?\d++)?|inf|infinity|nan(\(\w*+\))?)", re.IGNORECASE)


@dataclass(frozen=True)
class Words:
    """The words of a block of whole lines, with T words in L non-blank lines.

    Parameters
    ----------
    source : Source
        The file, which messages name.
    base : int
        Offset of the block in the file, in bytes.
    text : (B,) uint8
        The bytes of the block, with comments replaced by spaces.
    start, end : (T,) int64
        Offsets of each word in `text`.
    first : (L,) int64
        Index of the first word of each line.
    count : (L,) int64
        Number of words in each line.
    """

    source: Source
    base: int
    text: NDArray[np.uint8]
    start: NDArray[np.int64]
    end: NDArray[np.int64]
    first: NDArray[np.int64]
    count: NDArray[np.int64]

    def lines_beginning(self, word: bytes) -> NDArray[np.bool_]:
        """Return a mask (L,) of the lines whose first word is `word`."""
        start = self.start[self.first]
        lines = np.flatnonzero(self.end[self.first] - start == len(word))
        for at, byte in enumerate(word):
            lines = lines[self.text[start[lines] + at] == byte]
        mask = np.zeros(len(start), dtype=np.bool_)
        mask[lines] = True
        return mask

    def arguments(self, lines: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask (T,) of the words in the selected lines (L,), without the first word of each line."""
        mask = np.repeat(lines, self.count)
        mask[self.first] = False
        return mask

    def without_suffix(self, separator: bytes) -> Words:
        """Return the words. Each word is truncated before its first `separator` (one byte)."""
        return replace(self, end=np.minimum(self.end, self._next(separator)))

    def after(self, separator: bytes) -> Words:
        """Return the part of each word after its first `separator` (one byte).

        The part is empty for words without a separator.
        """
        return replace(self, start=np.minimum(self._next(separator) + 1, self.end))

    def _next(self, separator: bytes) -> NDArray[np.int64]:
        """Return the offset (T,) of the first `separator` at or after the start of each word."""
        places = np.flatnonzero(self.text == ord(separator))
        return np.append(places, len(self.text))[np.searchsorted(places, self.start)]

    def numbers(self, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the selected words (T,) parsed as float64, correctly rounded."""
        start, end = self.start[chosen], self.end[chosen]
        if not start.size:
            return np.zeros(0)
        # Replace everything outside the selected words by spaces, and parse the block in a single call.
        edges = np.zeros(len(self.text) + 1, dtype=np.int8)
        edges[start] += 1
        edges[end] -= 1
        inside = np.cumsum(edges[:-1], dtype=np.int8).astype(np.bool_)
        values = _parse(np.where(inside, self.text, np.uint8(ord(" "))).tobytes())
        if values is None or values.size != start.size:
            raise self._bad_number(start, end)
        return values

    def indices(self, chosen: NDArray[np.bool_], above: NDArray[np.int64], of: str) -> NDArray[np.int64]:
        """Return the selected words (T,) as zero-based OBJ indices.

        In the file, positive indices count from 1. Negative indices count backwards. The index -1 means the
        last element above the line. The argument `above` (L,) is the number of elements above each line.
        Messages use `of` as the name of the elements.
        """
        values = self.numbers(chosen)
        at = find_not_whole(values)
        why = "is not a whole number of at most 2**53"
        if at is None:
            indices = values.astype(np.int64) - 1
            if (values < 0).any():
                indices = np.where(values < 0, np.repeat(above, self.count)[chosen] + indices + 1, indices)
            if not (indices < 0).any():
                return indices
            at = int(np.argmax(indices < 0))
            why = f"is invalid: indices count from 1, or backwards from -1, the last {of} above the line"
        byte = self.base + int(self.start[chosen][at])
        raise self.source.line_error("MESH_FILE_INVALID", byte, f"index {values[at]:.15g} {why}")

    def has_fraction(self) -> NDArray[np.bool_]:
        """Return a mask (T,) of the words that are not plain integers. Examples are 1.0, 1e3 and nan."""
        marks = np.append(0, np.cumsum(_IS_FRACTION[self.text]))
        return marks[self.end] > marks[self.start]

    def line_error(self, code: str, line: int, message: str) -> MeshFileError:
        """Return an error about line `line` of the L lines in this block."""
        byte = self.base + int(self.start[self.first[line]])
        return self.source.line_error(code, byte, message)

    def _bad_number(self, start: NDArray[np.int64], end: NDArray[np.int64]) -> MeshFileError:
        """Return the error about the first word that is not a number.

        The arguments `start` and `end` (N,) are the offsets of the words.
        """
        for first, last in zip(start.tolist(), end.tolist(), strict=True):
            word = self.text[first:last].tobytes()
            if not _NUMBER.fullmatch(word):
                text = f"'{shorten(word.decode('latin-1'))}' is not a number"
                return self.source.line_error("MESH_FILE_INVALID", self.base + first, text)
        return self.source.error("MESH_FILE_INVALID", "a word is not a number")


def word_blocks(source: Source, start: int = 0, *, comments: bool = False) -> Iterator[Words]:
    """Yield the words of a text, starting at byte `start`, in blocks of about `BLOCK_BYTES`.

    With `comments`, "#" starts a comment that extends to the end of the line.
    """
    size = len(source.data)
    while start < size:
        line_end = source.data.find(b"\n", start + BLOCK_BYTES)
        end = size if line_end < 0 else line_end + 1
        yield _split_words(source, start, end, comments)
        start = end


@dataclass(frozen=True)
class Table:
    """The numbers of a part of a text file, with T numbers in R non-blank lines.

    Parameters
    ----------
    source : Source
        The file, which messages name.
    values : (T,) float64
        The numbers.
    row : (R + 1,) int64
        Offset in `values` of the first number of each line. The last entry is T.
    byte : (R,) int64
        Offset in the file of the first word of each line, in bytes.
    has_fraction : (T,) bool
        Whether each number is written as 1.0, 1e3 or nan, and not as a plain integer.
    """

    source: Source
    values: NDArray[np.float64]
    row: NDArray[np.int64]
    byte: NDArray[np.int64]
    has_fraction: NDArray[np.bool_]

    def row_error(self, code: str, row: int, message: str) -> MeshFileError:
        """Return an error about line `row` of the R lines in this table."""
        return self.source.line_error(code, int(self.byte[row]), message)

    def integers(self, places: NDArray[np.int64], what: str) -> NDArray[np.int64]:
        """Return the `values` at `places` as integers, in the shape of `places`.

        If a value is not an integer, the error names the values with the text `what`.
        """
        values = self.values[places]
        bad = find_not_whole(values.ravel())
        if bad is not None:
            row = int(np.searchsorted(self.row, places.ravel()[bad], side="right")) - 1
            text = f"{what} is {values.ravel()[bad]!s}, not a whole number of at most 2**53"
            raise self.row_error("MESH_FILE_INVALID", row, text)
        return values.astype(np.int64)


def read_table(source: Source, start: int, *, comments: bool = False) -> Table:
    """Return all numbers of a text, starting at byte `start`.

    The argument `comments` has the same meaning as in `word_blocks`.
    """
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


def find_not_whole(values: NDArray[np.float64]) -> int | None:
    """Return the index of the first value in `values` (T,) that is not an exact integer, or None."""
    bad = np.flatnonzero(~((values == np.floor(values)) & (np.abs(values) <= EXACT_INTEGER)))
    return int(bad[0]) if bad.size else None


def _split_words(source: Source, start: int, end: int, comments: bool) -> Words:
    """Return the words between the offsets `start` and `end`.

    The text between the offsets must consist of whole lines.
    """
    text = np.frombuffer(source.data, dtype=np.uint8, count=end - start, offset=start)
    line_end = text == ord("\n")
    if comments:
        text = _blank_comments(text, line_end)
    # Find the changes between white space and text, at which words begin and end.
    space = np.ones(len(text) + 2, dtype=np.bool_)
    space[1:-1] = _IS_SPACE[text]
    edges = np.flatnonzero(space[1:] != space[:-1])
    begins = edges[0::2]
    # A word begins a line if a line end lies between this word and the previous word.
    line = np.cumsum(line_end, dtype=np.int32)[begins]
    first = np.flatnonzero(np.diff(line, prepend=-1))
    count = np.diff(first, append=len(begins))
    return Words(source, start, text, begins, edges[1::2], first, count)


def _blank_comments(text: NDArray[np.uint8], line_end: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return `text` (B,) with everything from "#" to the end of the line replaced by spaces."""
    marks = np.cumsum(text == ord("#"), dtype=np.int32)
    if not marks.size or not marks[-1]:
        return text
    # A byte is in a comment if there is a "#" between the start of its line and the byte.
    before_line = np.maximum.accumulate(np.where(line_end, marks, 0))
    return np.where((marks > before_line) & ~line_end, np.uint8(ord(" ")), text)


def _parse(text: bytes) -> NDArray[np.float64] | None:
    """Return the numbers in a non-blank text, or None if the text contains anything else."""
    with warnings.catch_warnings():
        # Older versions of NumPy warn instead of raising an error.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None
