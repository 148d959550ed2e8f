"""A submission: results made fit to be published, as one file that whoever receives it can check.

It holds the records, hashes of what they were measured on, the commands that make them again and a few small
pictures; paths, and names of people and machines, are taken out. The file is a ZIP of stored members with
fixed dates, so the same results give the same bytes, and nothing in it can grow when it is unpacked. A list
in it has the SHA-256 of every other member.
"""

from __future__ import annotations

import getpass
import hashlib
import io
import json
import platform
import re
import shlex
import stat
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

from pydantic import Field

from msb.asset.strict_zip import Member, Policy, read_members
from msb.base.files import file_sha256, map_file
from msb.base.version import __version__
from msb.bench.checked import Name, Record, Sha256, checked, parse_json
from msb.bench.digest import list_sha256
from msb.bench.records import CONDITIONS, MAX_BYTES, Cell, Result, checked_result
from msb.bench.track import read_track
from msb.errors import InputError, MsbError, UsageError, shorten
from msb.registry import METHODS

SCHEMA: Literal["msb.submission/1"] = "msb.submission/1"
ABOUT = "submission.json"
WITHHELD = "withheld"
"""It stands where a path, or the name of a person or machine, stood."""
MOST_PICTURES = 200
_MOST_RECORDS = 20_000
_MAX_FILE = 1 << 30
_MAX_ABOUT = 16 << 20
_MAX_PICTURE = 1 << 20
_EPOCH = (1980, 1, 1, 0, 0, 0)
_MEMBER = re.compile(r"submission\.json|records/\d{5}\.json|pictures/\d{4}\.jpg")
_PATH_KEYS = ("path", "output", "mesh", "source")
_MESSAGES = ("message", "why", "reason", "driver_reason", "lpips_reason")
_IN_PATH = r"[^\s\"'<>|,;()\[\]]"
_ABSOLUTE = re.compile(rf"(?<![\w.])(?:~|[A-Za-z]:|file:/|\.\.?)?[/\\]{_IN_PATH}+")
"""A path from the root, a home or a folder above, in a text."""
_ANY_PATH = re.compile(rf"{_IN_PATH}*[/\\]{_IN_PATH}+|{_IN_PATH}+[/\\]")
_ANYBODY = frozenset(
    {"root", "user", "admin", "ubuntu", "debian", "runner", "localhost", "gpu", "cpu", *CONDITIONS}
)
"""Names of accounts and machines that say nothing of anybody, and words of ours."""


class Shown(Record):
    """A picture of a submission: what it shows, and its file. Without a condition it is the photograph."""

    file: Name
    dataset: Name
    scene: Name
    image: Name
    why: str
    method: Name | None = None
    condition: Name | None = None
    psnr: float | None = None


class About(Record):
    """The list in a submission: who sent it, of what, and the SHA-256 of every member."""

    schema_: Literal["msb.submission/1"] = Field(default=SCHEMA, alias="schema")
    name: Annotated[str, Field(min_length=1, max_length=60)]
    """What the submitter wants to be called."""
    tool_version: Name
    code_sha256: Sha256
    """That of the list of hashes of the package's files, where the submission was made."""
    commands: tuple[str, ...]
    """What makes the records again, with the names of scenes and models in the place of their paths."""
    files: dict[Name, Sha256]
    pictures: Annotated[tuple[Shown, ...], Field(max_length=MOST_PICTURES)]


@dataclass(frozen=True)
class Submission:
    """A submission that was read and verified."""

    path: Path
    sha256: str
    about: About
    records: tuple[Result, ...]
    pictures: Mapping[str, bytes]
    """Name of a member -> a JPEG."""


def write_submission(
    name: str,
    records: Sequence[Result],
    pictures: Sequence[tuple[Shown, bytes]],
    *,
    private: Iterable[str] = (),
) -> bytes:
    """Return the file of a submission.

    Parameters
    ----------
    name : str
        What the submitter wants to be called.
    records : sequence of Result
    pictures : sequence of (Shown, bytes)
        At most `MOST_PICTURES` JPEGs; the names of their files are given here.
    private : iterable of str
        Paths that must not be in the file, besides the home and the current folder and the
        paths in the records.

    Raises
    ------
    UsageError
        The name of a scene, dataset, model or variant holds one of them, so it cannot be taken out.
    """
    scrub = Scrub([*private, *(path for record in records for path in _paths(record.model_dump()))])
    ordered = sorted(records, key=lambda record: record.cell.names)
    for record in ordered:
        scrub.check_cell(record.cell)
    members: dict[str, bytes] = {}
    for number, record in enumerate(ordered):
        data = scrub.data(json.loads(record.to_json()))
        text = json.dumps(data, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False)
        members[f"records/{number:05d}.json"] = text.encode()
        checked_result(json.loads(text), file=Path(name))
    shown = []
    for number, (one, data) in enumerate(pictures[:MOST_PICTURES]):
        file = f"pictures/{number:04d}.jpg"
        members[file] = data
        shown.append(one.model_copy(update={"file": file, "image": scrub.text(one.image)}))
    about = About(
        name=name,
        tool_version=__version__,
        code_sha256=code_sha256(),
        commands=tuple(map(scrub.text, _commands(ordered))),
        files={file: hashlib.sha256(data).hexdigest() for file, data in members.items()},
        pictures=tuple(shown),
    )
    return archive_of({ABOUT: about.to_json(), **members})


class Scrub:
    """What takes private words out of texts."""

    def __init__(self, private: Iterable[str] = ()) -> None:
        home = Path.home()
        given = set(filter(None, private))
        paths = given | {str(Path(path).parent) for path in given} | {str(home), str(Path.cwd())}
        hosts = {platform.node(), platform.node().partition(".")[0]}
        words = {home.name, *hosts}
        with suppress(OSError, KeyError, ImportError):  # nobody is called by that number
            words.add(getpass.getuser())
        self._paths = sorted(
            (path for path in paths if len(path) > 2 and {"/", "\\"} & set(path)), key=len, reverse=True
        )
        own = {word for word in words if len(word) > 1} - _ANYBODY - METHODS.keys()
        either = "|".join(map(re.escape, sorted(own, key=len, reverse=True)))
        self._words = re.compile(rf"(?<![^\W_])(?:{either})(?![^\W_])", re.IGNORECASE) if own else None

    def text(self, text: str, pattern: re.Pattern[str] = _ABSOLUTE) -> str:
        """Return a text without private words and without what `pattern` finds."""
        for path in self._paths:
            text = text.replace(path, WITHHELD)
        text = pattern.sub(WITHHELD, text)
        return text if self._words is None else self._words.sub(WITHHELD, text)

    def data(self, value: Any, key: str = "") -> Any:
        """Return JSON data of a record without private words; the names of its cell stay."""
        if isinstance(value, dict):
            return {
                name: inner if name == "cell" else self.data(inner, name) for name, inner in value.items()
            }
        if isinstance(value, list):
            return [self.data(inner, key) for inner in value]
        if not isinstance(value, str):
            return value
        if key in _PATH_KEYS:
            return WITHHELD
        if key == "gt":
            value = "/".join(value.split("/")[-2:])
        return self.text(value, _ANY_PATH if key in _MESSAGES else _ABSOLUTE)

    def check_cell(self, cell: Cell) -> None:
        """Refuse names that cannot be taken out, because they say what was measured."""
        for kind, name in cell.model_dump().items():
            if name is not None and (self.text(str(name)) != name):
                text = (
                    f"the {kind} of a record is called {shorten(repr(name), 60)}, which holds a path, or the "
                    "name of this machine or its user; give it another in the protocol, and run it again"
                )
                raise UsageError("USAGE", text)


def _paths(value: Any, key: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _paths(inner, name)
    elif isinstance(value, str) and key in _PATH_KEYS and value != WITHHELD and set(value) & {"/", "\\"}:
        yield value


def code_sha256() -> str:
    """Return the SHA-256 of the list of hashes of the package's own files."""
    root = Path(str(files("msb")))
    own = (path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return list_sha256((path.relative_to(root).as_posix(), file_sha256(path)) for path in own)


def _commands(records: Sequence[Result]) -> Iterator[str]:
    """Yield what trained the models, where that was recorded, and what evaluates them."""
    models: dict[tuple[str, ...], list[Result]] = {}
    for record in records:
        models.setdefault(record.cell.names[:3], []).append(record)
    for (dataset, scene, model), own in models.items():
        for source in dict.fromkeys(one.training.source for one in own if one.training is not None):
            with suppress(MsbError, ValueError):  # it is no longer there
                words = [_plain_word(word) for word in read_track(Path(source)).command]
                yield f"msb track -- {shlex.join(words)}"
        words = ["msb", "run", "--scene", f"{dataset}/{scene}"]
        folders = {one.setup.image_folder for one in own if one.setup is not None} - {"."}
        words += ["--image-folder", min(folders)] if folders else []
        kinds = {one.renderer.kind for one in own if one.renderer and one.cell.condition == "non_engine"}
        words += ["--non-engine", "reference" if "msb_reference" in kinds else "renders"] if kinds else []
        yield shlex.join([*words, model])


def _plain_word(word: str) -> str:
    """Return a word of a command, without what of it is a path."""
    option, equals, value = word.rpartition("=")
    return f"{option}{equals}{WITHHELD}" if {"/", "\\"} & set(value) else word


def archive_of(members: Mapping[str, bytes]) -> bytes:
    """Return the archive of members, the same bytes at all times."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.create_system, entry.external_attr = 3, (stat.S_IFREG | 0o644) << 16
            archive.writestr(entry, data)
    return buffer.getvalue()


class _Members(Policy):
    """What a submission may hold: plain files of the three kinds, none of them compressed."""

    max_members = 1 + _MOST_RECORDS + MOST_PICTURES

    def __init__(self, file: Path) -> None:
        self.file = file

    def refuse(self, code: str, message: str, at: int) -> NoReturn:
        raise InputError("RECORD_INVALID", message, file=self.file, pointer=f"byte {at}")

    def name(self, raw: bytes, flags: int, at: int) -> str:
        text = raw.decode("ascii", "replace")
        if not _MEMBER.fullmatch(text):
            kinds = f"{ABOUT}, records/NNNNN.json and pictures/NNNN.jpg"
            self.refuse("PATH", f'the member "{shorten(text, 60)}" is none of {kinds}', at)
        return text

    def check_entry(self, name: str, extra: int, attributes: int, at: int) -> None:
        if extra or stat.S_IFMT(attributes >> 16) not in (0, stat.S_IFREG) or attributes & 0x10:
            self.refuse("PATH", f"{name} is a link, folder or device, or has data in its header", at)


def is_submission(path: Path) -> bool:
    """Return whether a path is that of a submission, by its name alone."""
    return path.suffix.lower() == ".zip"


def read_submission(path: Path) -> Submission:
    """Return a submission, every byte of it verified.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE; RECORD_INVALID: it is no archive as `write_submission` makes it, a
        member's hash is not that in the list, a member is missing or unlisted, too large, or not valid.
    """
    return _Reader(path).read()


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = map_file(path, _MAX_FILE + 1)
        if len(self.data) > _MAX_FILE:
            raise InputError("RECORD_INVALID", f"it is longer than {_MAX_FILE:,} bytes", file=path)
        self.members = read_members(self.data, _Members(path))

    @cached_property
    def about(self) -> About:
        if ABOUT not in self.members:
            raise self.bad(f"there is no {ABOUT} in it, as msb submit writes")
        about = checked(About, self.document(ABOUT, _MAX_ABOUT), file=self.path, code="RECORD_INVALID")
        if others := about.files.keys() ^ (self.members.keys() - {ABOUT}):
            raise self.bad(f"{shorten(min(others), 60)} is in its list or in the file, and not in both")
        return about

    def read(self) -> Submission:
        about = self.about
        records, pictures = [], {}
        for name, sha256 in about.files.items():
            if hashlib.sha256(self.content(name, MAX_BYTES)).hexdigest() != sha256:
                raise self.bad(f"{name} is not the one that was submitted: its SHA-256 is another")
            if name.startswith("records/"):
                records.append(checked_result(self.document(name, MAX_BYTES), file=f"{self.path}: {name}"))
            else:
                pictures[name] = self.content(name, _MAX_PICTURE)
        cells = [record.cell for record in records]
        if len({cell.names for cell in cells}) < len(cells) or not cells:
            raise self.bad("it holds no record" if not cells else "it holds two records of one cell")
        if missing := {shown.file for shown in about.pictures} - pictures.keys():
            raise self.bad(f"the picture {shorten(min(missing), 60)} is not in it")
        return Submission(self.path, hashlib.sha256(self.data).hexdigest(), about, tuple(records), pictures)

    def bad(self, text: str) -> InputError:
        return InputError("RECORD_INVALID", text, file=self.path)

    def content(self, name: str, most: int) -> bytes:
        member: Member = self.members[name]
        if member.size > most:
            raise self.bad(f"{name} has {member.size:,} bytes; {most:,} are allowed")
        return bytes(self.data[member.offset : member.offset + member.size])

    def document(self, name: str, most: int) -> Any:
        return parse_json(self.content(name, most), most, file=f"{self.path}: {name}")
