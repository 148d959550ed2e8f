"""A submission: results made fit to be published, as one file that whoever receives it can check.

It holds the published fields of the records (numbers, hashes, versions, names of scenes, methods and
devices), the commands that evaluate the models again, and a few small pictures. Texts that may hold a path or
the name of a person are never published. The file is a ZIP of stored members with fixed dates, so the same
results give the same bytes, and nothing in it can grow when it is unpacked. A list in it has the SHA-256 of
every other member.
"""

import hashlib
import io
import json
import re
import shlex
import stat
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, NoReturn

from pydantic import Field

from msb.asset.strict_zip import Policy, read_members
from msb.base.files import file_sha256, map_file
from msb.base.version import __version__
from msb.bench.checked import Name, Record, Sha256, checked, parse_json
from msb.bench.digest import list_sha256
from msb.bench.records import MAX_BYTES, Result, checked_result
from msb.errors import InputError, shorten
from msb.metrics.registry import IMAGE_METRICS

SCHEMA: Literal["msb.submission/1"] = "msb.submission/1"
ABOUT = "submission.json"
# Published in place of a text that a record must have and that may be private.
WITHHELD = "withheld"
MOST_PICTURES = 200
_MOST_RECORDS = 20_000
_MAX_FILE = 1 << 30
_MAX_ABOUT = 16 << 20
_MAX_PICTURE = 1 << 20
_EPOCH = (1980, 1, 1, 0, 0, 0)
_MEMBER = re.compile(r"submission\.json|records/\d{5}\.json|pictures/\d{4}\.jpg")
_KEEP = object()


def _keep(*names: str) -> dict[str, Any]:
    return dict.fromkeys(names, _KEEP)


class _Each(NamedTuple):
    """The fields of every value of a mapping."""

    fields: Any


_REASON = _keep("code") | {"message": WITHHELD}
_FILE = _keep("bytes", "sha256") | {"path": WITHHELD}
_WEIGHTS = _keep("sha256", "tensors_sha256", "known") | {"file": WITHHELD}
_VERDICT = _keep("level", "sentence")
_LOOK = _keep("psnr", "same") | {"why": WITHHELD}


def _fields() -> dict[str, Any]:
    """Return the published fields of a record.

    Each name leads to the fields below it, to `_KEEP`, or to a constant. The constant replaces any value
    other than None.
    """
    metrics = dict.fromkeys(IMAGE_METRICS, _KEEP)
    image = {**_keep("name", "width", "height", "psnr_infinite", "sha256"), "file": WITHHELD, "gt": WITHHELD}
    identity = _keep("name", "version", "better", "unit", "parameters", "libraries")
    looks = {"standard": _LOOK, "dedicated": _LOOK}
    return {
        **_keep(
            "schema", "tool_version", "cell", "status", "seconds", "setup", "renderer", "timing", "floor"
        ),
        "reason": _REASON,
        **dict.fromkeys(("checkpoint", "asset", "source", "renders"), _FILE),
        "device": {"device": _keep("platform", "name", "kind", "version", "driver", "blends")},
        "quality": {
            **_keep("lpips_reason", "psnr_inf_count"),
            **metrics,
            "images": {**image, **metrics},
            "metrics": {**identity, "weights": {"vgg": _WEIGHTS, "heads": _WEIGHTS}},
            "missing": _Each(WITHHELD),
        },
        "memory": _keep("geometry", "appearance", "scratch", "targets", "uses", "driver_bytes"),
        "chamfer": {**_keep("mean_d2s", "mean_s2d", "overall", "seed", "scan"), "metric": identity},
        "audit": {
            **_keep(
                "schema", "topology", "is_soup", "counts", "metrics", "winding_consistent", "computed_by"
            ),
            "verdict": _VERDICT,
        },
        "bake": {
            **_keep("schema", "geometry", "color", "vertices", "faces", "texture", "bytes", "seconds"),
            **_keep("unseen_area", "psnr", "model_faces", "background", "seed", "tried", "sentence"),
            **dict.fromkeys(("verdict_before", "verdict_after"), _VERDICT),
        },
        "trial": {
            "schema": _KEEP,
            "trials": _keep("task", "title", "outcome", "seconds", "libraries")
            | {"why": WITHHELD, "says": "", "picture": None},
        },
        "repairs": {
            **_keep("schema", "views"),
            "strategies": {
                **_keep("strategy", "plan", "peer", "faces_kept", "faces_added", "edges_cut", "components"),
                **_keep("verdict_after", "trials", "trials_passed_before", "trials_passed_after"),
                **_keep("bytes", "seconds"),
                "why": WITHHELD,
                "looks": looks,
                "picture": None,
            },
        },
        "walk": _keep(
            "frames", "width", "height", "flicker", "flicker_worst", "worst_frame", "holes", "seconds"
        )
        | {"film": None},
        "training": _keep("seconds", "peak_memory_bytes") | {"source": WITHHELD},
        "trained": _KEEP,
        "renderer_timing": _keep(
            "schema", "frames", "seconds", "device", "whole_command", "peak_gpu_memory_bytes"
        )
        | {"timed": WITHHELD},
        "reasons": _Each(_REASON),
        "inputs": {"quality": _keep("cameras", "photographs", "metrics")},
    }


def _published(data: Any, fields: Any) -> Any:
    """Return the fields of JSON data that are published."""
    if data is None or fields is _KEEP:
        return data
    if isinstance(data, list):
        return [_published(one, fields) for one in data]
    if isinstance(fields, _Each):
        return {name: _published(one, fields.fields) for name, one in data.items()}
    if isinstance(fields, dict):
        return {name: _published(data[name], inner) for name, inner in fields.items() if name in data}
    return fields


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
    # What the submitter wants to be called.
    name: Annotated[str, Field(min_length=1, max_length=60)]
    tool_version: Name
    # That of the list of hashes of the package's files, where the submission was made.
    code_sha256: Sha256
    # Evaluate the models again, with the names of scenes and models in the place of their paths.
    commands: tuple[str, ...]
    files: dict[Name, Sha256]
    pictures: Annotated[tuple[Shown, ...], Field(max_length=MOST_PICTURES)]


@dataclass(frozen=True)
class Submission:
    """A submission that was read and verified."""

    path: Path
    sha256: str
    about: About
    records: tuple[Result, ...]
    # Name of a member -> a JPEG.
    pictures: Mapping[str, bytes]


def write_submission(name: str, records: Sequence[Result], pictures: Sequence[tuple[Shown, bytes]]) -> bytes:
    """Return the file of a submission.

    Parameters
    ----------
    name : str
        What the submitter wants to be called.
    records : sequence of Result
    pictures : sequence of (Shown, bytes)
        At most `MOST_PICTURES` JPEGs; the names of their files are given here.
    """
    ordered = sorted(records, key=lambda record: record.cell.names)
    fields = _fields()
    members: dict[str, bytes] = {}
    for number, record in enumerate(ordered):
        data = _published(json.loads(record.to_json()), fields)
        text = json.dumps(data, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False)
        members[f"records/{number:05d}.json"] = text.encode()
        checked_result(json.loads(text), file=Path(name))
    shown = []
    for number, (one, data) in enumerate(pictures[:MOST_PICTURES]):
        file = f"pictures/{number:04d}.jpg"
        members[file] = data
        shown.append(one.model_copy(update={"file": file}))
    about = About(
        name=name,
        tool_version=__version__,
        code_sha256=code_sha256(),
        commands=tuple(_commands(ordered)),
        files={file: hashlib.sha256(data).hexdigest() for file, data in members.items()},
        pictures=tuple(shown),
    )
    return archive_of({ABOUT: about.to_json(), **members})


def code_sha256() -> str:
    """Return the SHA-256 of the list of hashes of the package's own files."""
    root = Path(str(files("msb")))
    own = (path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return list_sha256((path.relative_to(root).as_posix(), file_sha256(path)) for path in own)


def _commands(records: Sequence[Result]) -> Iterator[str]:
    """Yield the command that evaluates each model."""
    models: dict[tuple[str, ...], list[Result]] = {}
    for record in records:
        models.setdefault(record.cell.names[:3], []).append(record)
    for (dataset, scene, model), own in models.items():
        words = ["msb", "run", "--scene", f"{dataset}/{scene}"]
        folders = {one.setup.image_folder for one in own if one.setup is not None} - {"."}
        words += ["--image-folder", min(folders)] if folders else []
        kinds = {one.renderer.kind for one in own if one.renderer and one.cell.condition == "non_engine"}
        words += ["--non-engine", "reference" if "msb_reference" in kinds else "renders"] if kinds else []
        yield shlex.join([*words, model])


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
    data = map_file(path, _MAX_FILE + 1)
    if len(data) > _MAX_FILE:
        raise _invalid(path, f"it is longer than {_MAX_FILE:,} bytes")
    members = read_members(data, _Members(path))

    def content(name: str, most: int) -> bytes:
        member = members[name]
        if member.size > most:
            raise _invalid(path, f"{name} has {member.size:,} bytes; {most:,} are allowed")
        return bytes(data[member.offset : member.offset + member.size])

    def document(name: str, most: int) -> Any:
        return parse_json(content(name, most), most, file=f"{path}: {name}")

    if ABOUT not in members:
        raise _invalid(path, f"there is no {ABOUT} in it, as msb submit writes")
    about = checked(About, document(ABOUT, _MAX_ABOUT), file=path, code="RECORD_INVALID")
    if others := about.files.keys() ^ (members.keys() - {ABOUT}):
        raise _invalid(path, f"{shorten(min(others), 60)} is in its list or in the file, and not in both")
    records, pictures = [], {}
    for name, sha256 in about.files.items():
        if hashlib.sha256(content(name, MAX_BYTES)).hexdigest() != sha256:
            raise _invalid(path, f"{name} is not the one that was submitted: its SHA-256 is another")
        if name.startswith("records/"):
            records.append(checked_result(document(name, MAX_BYTES), file=f"{path}: {name}"))
        else:
            pictures[name] = content(name, _MAX_PICTURE)
    cells = {record.cell.names for record in records}
    if len(cells) < len(records) or not records:
        raise _invalid(path, "it holds no record" if not records else "it holds two records of one cell")
    if missing := {shown.file for shown in about.pictures} - pictures.keys():
        raise _invalid(path, f"the picture {shorten(min(missing), 60)} is not in it")
    return Submission(path, hashlib.sha256(data).hexdigest(), about, tuple(records), pictures)


def _invalid(path: Path, text: str) -> InputError:
    return InputError("RECORD_INVALID", text, file=path)
