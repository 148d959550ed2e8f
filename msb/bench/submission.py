"""Submissions: benchmark results in a single file that the receiver can verify.

A submission contains the published fields of the records, the commands that repeat the evaluation, and a few
small images. The published fields are numbers, hashes, versions, and names of scenes, methods and devices.
Strings that may contain a path or the name of a person are not published.

The file is a ZIP archive with fixed dates, so equal results give equal bytes. The archive is not compressed,
so that a small file cannot expand to large members. The member submission.json lists the SHA-256 of all other
members.
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
from msb.bench.digest import list_sha256
from msb.bench.records import MAX_BYTES, Result, validate_result
from msb.bench.validation import Name, Record, Sha256, parse_json, validate
from msb.errors import InputError, shorten
from msb.metrics.registry import IMAGE_METRICS

SCHEMA: Literal["msb.submission/1"] = "msb.submission/1"
ABOUT = "submission.json"
# Text that replaces a private string in a required field.
WITHHELD = "withheld"
MOST_PICTURES = 200
_MOST_RECORDS = 20_000
# Maximum sizes in bytes of the file, of the list of members, and of an image.
_MAX_FILE = 1 << 30
_MAX_ABOUT = 16 << 20
_MAX_PICTURE = 1 << 20
# Date of every archive member: the earliest date that ZIP can store.
_EPOCH = (1980, 1, 1, 0, 0, 0)
_MEMBER = re.compile(r"submission\.json|records/\d{5}\.json|pictures/\d{4}\.jpg")
# Mark for fields that are published unchanged.
_KEEP = object()


def _keep(*names: str) -> dict[str, Any]:
    """Return rules that publish fields unchanged."""
    return dict.fromkeys(names, _KEEP)


class _Values(NamedTuple):
    """The rule for a mapping with arbitrary keys.

    All values of the mapping have the same published fields.
    """

    fields: Any


_REASON = _keep("code") | {"message": WITHHELD}
_FILE = _keep("bytes", "sha256") | {"path": WITHHELD}
_WEIGHTS = _keep("sha256", "tensors_sha256", "known") | {"file": WITHHELD}
_VERDICT = _keep("level", "sentence")
_LOOK = _keep("psnr", "same") | {"why": WITHHELD}


def _list_published_fields() -> dict[str, Any]:
    """Return the rules for publishing the fields of a record. The keys are the names of the fields.

    The rule for a field is a nested mapping, `_KEEP`, or a constant.

    If the rule of a field is a constant, every value except None is replaced by the constant.
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
            "missing": _Values(WITHHELD),
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
        "training": _keep("seconds", "peak_memory_bytes", "trainer")
        | dict.fromkeys(("source", "memory_reason"), WITHHELD),
        "trained": _KEEP,
        "renderer_timing": _keep(
            "schema", "frames", "seconds", "device", "whole_command", "peak_gpu_memory_bytes"
        )
        | {"timed": WITHHELD},
        "reasons": _Values(_REASON),
        "inputs": {"quality": _keep("cameras", "photographs", "metrics")},
    }


def _select(data: Any, fields: Any) -> Any:
    """Return JSON data without the fields that are not published."""
    if data is None or fields is _KEEP:
        return data
    if isinstance(data, list):
        return [_select(value, fields) for value in data]
    if isinstance(fields, _Values):
        return {name: _select(value, fields.fields) for name, value in data.items()}
    if isinstance(fields, dict):
        return {name: _select(data[name], inner) for name, inner in fields.items() if name in data}
    return fields


class SubmittedImage(Record):
    """An image in a submission. Photographs have no condition."""

    file: Name
    dataset: Name
    scene: Name
    image: Name
    why: str
    method: Name | None = None
    condition: Name | None = None
    psnr: float | None = None


class About(Record):
    """The content of submission.json: the submitter, the commands, and the SHA-256 of every other member."""

    schema_: Literal["msb.submission/1"] = Field(default=SCHEMA, alias="schema")
    # The name of the submitter, as free text.
    name: Annotated[str, Field(min_length=1, max_length=60)]
    tool_version: Name
    # Hash of the package's code on the submitter's machine (`code_sha256`).
    code_sha256: Sha256
    # The commands that repeat the evaluation, with names of scenes and models instead of paths.
    commands: tuple[str, ...]
    files: dict[Name, Sha256]
    pictures: Annotated[tuple[SubmittedImage, ...], Field(max_length=MOST_PICTURES)]


@dataclass(frozen=True)
class Submission:
    """A submission that was read and verified."""

    path: Path
    sha256: str
    about: About
    records: tuple[Result, ...]
    # Content of each JPEG by the name of its member.
    pictures: Mapping[str, bytes]


def write_submission(
    name: str, records: Sequence[Result], pictures: Sequence[tuple[SubmittedImage, bytes]]
) -> bytes:
    """Return the content of a submission file.

    Parameters
    ----------
    name : str
        The name of the submitter.
    records : sequence of Result
    pictures : sequence of (SubmittedImage, bytes)
        JPEG images; only the first `MOST_PICTURES` are used. The file names of the images are assigned in
        this function.
    """
    ordered = sorted(records, key=lambda record: record.cell.names)
    fields = _list_published_fields()
    members: dict[str, bytes] = {}
    # Validate each record as the receiver does.
    for number, record in enumerate(ordered):
        data = _select(json.loads(record.to_json()), fields)
        text = json.dumps(data, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False)
        members[f"records/{number:05d}.json"] = text.encode()
        validate_result(json.loads(text), file=Path(name))
    listed = []
    for number, (picture, data) in enumerate(pictures[:MOST_PICTURES]):
        file = f"pictures/{number:04d}.jpg"
        members[file] = data
        listed.append(picture.model_copy(update={"file": file}))
    about = About(
        name=name,
        tool_version=__version__,
        code_sha256=code_sha256(),
        commands=tuple(_make_commands(ordered)),
        files={file: hashlib.sha256(data).hexdigest() for file, data in members.items()},
        pictures=tuple(listed),
    )
    return make_archive({ABOUT: about.to_json(), **members})


def code_sha256() -> str:
    """Return the SHA-256 of the list of hashes of all files of the package msb."""
    root = Path(str(files("msb")))
    paths = (path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return list_sha256((path.relative_to(root).as_posix(), file_sha256(path)) for path in paths)


def _make_commands(records: Sequence[Result]) -> Iterator[str]:
    """Yield, for each model, a command that repeats its evaluation."""
    # The records of all conditions, by dataset, scene and model.
    models: dict[tuple[str, ...], list[Result]] = {}
    for record in records:
        models.setdefault(record.cell.names[:3], []).append(record)
    for (dataset, scene, model), group in models.items():
        words = ["msb", "run", "--scene", f"{dataset}/{scene}"]
        folders = {record.setup.image_folder for record in group if record.setup is not None} - {"."}
        words += ["--image-folder", min(folders)] if folders else []
        native = [record.renderer for record in group if record.cell.condition == "non_engine"]
        kinds = {renderer.kind for renderer in native if renderer is not None}
        words += ["--non-engine", "reference" if "msb_reference" in kinds else "renders"] if kinds else []
        yield shlex.join([*words, model])


def make_archive(members: Mapping[str, bytes]) -> bytes:
    """Return a ZIP archive. `members` maps the name of each member to its content.

    Return a ZIP archive. `members` maps the name of each member to its content. The bytes depend only on the
    members.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.create_system, entry.external_attr = 3, (stat.S_IFREG | 0o644) << 16
            archive.writestr(entry, data)
    return buffer.getvalue()


class _Members(Policy):
    """Rules for the members of a submission: uncompressed files with one of three kinds of names."""

    max_members = 1 + _MOST_RECORDS + MOST_PICTURES

    def __init__(self, file: Path) -> None:
        self.file = file

    def refuse(self, code: str, message: str, at: int) -> NoReturn:
        raise InputError("RECORD_INVALID", message, file=self.file, pointer=f"byte {at}")

    def name(self, raw: bytes, flags: int, at: int) -> str:
        text = raw.decode("ascii", "replace")
        if not _MEMBER.fullmatch(text):
            kinds = f"{ABOUT}, records/NNNNN.json or pictures/NNNN.jpg"
            self.refuse("PATH", f'the member "{shorten(text, 60)}" must be named {kinds}', at)
        return text

    def check_entry(self, name: str, extra: int, attributes: int, at: int) -> None:
        if extra or stat.S_IFMT(attributes >> 16) not in (0, stat.S_IFREG) or attributes & 0x10:
            self.refuse("PATH", f"{name} is not a plain file, or has additional data in its header", at)


def is_submission(path: Path) -> bool:
    """Return whether a path has the file extension of submissions."""
    return path.suffix.lower() == ".zip"


def read_submission(path: Path) -> Submission:
    """Read a submission and verify all of its content.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE. RECORD_INVALID if the file is not an archive in the format of
        `write_submission`. All faults of a member raise the same error: missing, unlisted, too large, invalid
        or changed.
    """
    data = map_file(path, _MAX_FILE + 1)
    if len(data) > _MAX_FILE:
        raise _make_error(path, f"the file is longer than {_MAX_FILE:,} bytes")
    members = read_members(data, _Members(path))

    def read_member(name: str, most: int) -> bytes:
        member = members[name]
        if member.size > most:
            raise _make_error(path, f"{name} has {member.size:,} bytes, but at most {most:,} are allowed")
        return bytes(data[member.offset : member.offset + member.size])

    def parse_member(name: str, most: int) -> Any:
        return parse_json(read_member(name, most), most, file=f"{path}: {name}")

    # The list must name all members of the archive, and no others.
    if ABOUT not in members:
        raise _make_error(path, f"the archive has no {ABOUT}; submissions are written by msb submit")
    about = validate(About, parse_member(ABOUT, _MAX_ABOUT), file=path, code="RECORD_INVALID")
    if others := about.files.keys() ^ (members.keys() - {ABOUT}):
        raise _make_error(
            path, f"{shorten(min(others), 60)} is in the list or in the archive, but not in both"
        )
    # Every member must be valid and have the listed hash.
    records, pictures = [], {}
    for name, sha256 in about.files.items():
        if hashlib.sha256(read_member(name, MAX_BYTES)).hexdigest() != sha256:
            raise _make_error(path, f"{name} was changed: its SHA-256 differs from the list")
        if name.startswith("records/"):
            records.append(validate_result(parse_member(name, MAX_BYTES), file=f"{path}: {name}"))
        else:
            pictures[name] = read_member(name, _MAX_PICTURE)
    cells = {record.cell.names for record in records}
    if len(cells) < len(records) or not records:
        fault = "there are two records of one cell" if records else "the archive contains no records"
        raise _make_error(path, fault)
    if missing := {picture.file for picture in about.pictures} - pictures.keys():
        raise _make_error(path, f"the image {shorten(min(missing), 60)} is missing")
    return Submission(path, hashlib.sha256(data).hexdigest(), about, tuple(records), pictures)


def _make_error(path: Path, text: str) -> InputError:
    return InputError("RECORD_INVALID", text, file=path)
