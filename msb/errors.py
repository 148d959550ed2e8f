"""The classes of errors, their codes, and the exit status of each class.

Every error that a user can cause has a stable code. Each code belongs to one class of errors, and all errors
of a class have one exit status. The command line prints errors as ``CODE: FILE: problem, place, remedy``.
"""

import contextlib
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from typing import Any, ClassVar, Literal, NamedTuple, Self

Severity = Literal["error", "warning", "info"]


def _names(text: str) -> frozenset[str]:
    return frozenset(text.split())


class MsbError(Exception):
    """Base class of all errors that msb reports.

    Parameters
    ----------
    code : str
        Stable name of the error, one of the `codes` of this class.
    message : str
        The problem, its place and the remedy, in one or two sentences without line breaks.
    file : str, optional
        The file or folder that causes the error.
    pointer : str, optional
        JSON pointer, byte offset ("byte 128"), line ("line 7") or array element ("indices[12, 0]").
    """

    codes: ClassVar[frozenset[str]] = frozenset()
    """The codes of this class. errors.toml explains them."""

    @property
    def exit_status(self) -> int:
        """The exit status of the command line for this class of errors."""
        return EXIT_STATUS[type(self)]

    def __init__(
        self,
        code: str,
        message: str,
        *,
        file: object = None,
        pointer: str | None = None,
    ) -> None:
        if code not in self.codes:
            raise TypeError(f"{code} is not a code of {type(self).__name__}")
        self.code = code
        self.message = one_line(message)
        self.file = None if file is None else str(file)
        self.pointer = pointer
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        # Worker processes send errors as pickles, which must preserve all attributes. Exceptions normally
        # restore only their printed text.
        return partial(type(self), file=self.file, pointer=self.pointer), (self.code, self.message)

    def at(self, file: object) -> Self:
        """Return a copy of this error that names the file `file`."""
        return type(self)(self.code, self.message, file=file, pointer=self.pointer)

    def __str__(self) -> str:
        where = "" if self.file is None else f"{one_line(self.file)}: "
        return f"{self.code}: {where}{self.message}"


class GateFailed(MsbError):
    """A requested condition is not met."""

    codes = _names("GATE_FAILED CROSS_CHECK_DISAGREES")


class UsageError(MsbError):
    """A command or a function call has an invalid argument. Input files are not the cause of these errors."""

    codes = _names("""
        USAGE EXTRA_MISSING VIEW_NO_DISPLAY OUTPUT_EXISTS RESULTS_MIXED NAME_UNKNOWN
        DEVICE_SELECTOR SETTING_UNKNOWN SETTING_VALUE PACKAGE_LEFT_OUT RESULTS_BUSY
        RUN_SCHEDULER ENGINE_MISSING
    """)


class InputError(MsbError):
    """An input file does not exist, cannot be read, or has an unknown format."""

    codes = _names("""
        FILE_NOT_FOUND FILE_UNREADABLE FILE_NOT_RECOGNISED RECORD_INVALID RESULTS_EMPTY RENDERS_CHANGED
        TRAINING_FAILED PROTOCOL_INVALID
    """)


class AssetError(MsbError):
    """A `.triasset` violates its format."""

    codes = _names("""
        TRIASSET_MANIFEST_MISSING TRIASSET_MANIFEST TRIASSET_VERSION_UNSUPPORTED TRIASSET_VERSION_NEWER
        TRIASSET_FIELD TRIASSET_FIELD_UNKNOWN TRIASSET_METHOD_NOT_INSTALLED TRIASSET_EMPTY TRIASSET_BOUNDS
        TRIASSET_PATH TRIASSET_FILE_UNREADABLE TRIASSET_FILE_UNDECLARED TRIASSET_BUFFER TRIASSET_DAMAGED
        TRIASSET_FORM TRIASSET_HOSTILE TRIASSET_VALUE_NONFINITE TRIASSET_VALUE_RANGE
        TRIASSET_INDEX_OUT_OF_RANGE TRIASSET_FACE_REPEATED_INDEX TRIASSET_FACE_DUPLICATE
        TRIASSET_FACE_ZERO_AREA TRIASSET_VERTEX_UNREFERENCED
    """)


class CheckpointError(MsbError):
    """A trained checkpoint (.pt, .ckpt) is damaged, malicious or not supported."""

    codes = _names("""
        CHECKPOINT_NOT_RECOGNISED CHECKPOINT_DAMAGED CHECKPOINT_HOSTILE CHECKPOINT_FORM CHECKPOINT_UNKNOWN
        CHECKPOINT_METHOD CHECKPOINT_FILE_MISSING CHECKPOINT_LAYOUT CHECKPOINT_NONFINITE CHECKPOINT_ROUNDED
        CHECKPOINT_CONFIG_MISSING CHECKPOINT_CONFIG
    """)


class SceneError(MsbError):
    """A camera, a camera file or a reconstruction is invalid."""

    codes = _names("""
        CAMERA_INVALID CAMERA_PATH CAMERA_SOURCE CAMERA_NONE CAMERA_DISTORTED CAMERA_IMAGE CAMERA_FILE
        COLMAP_INVALID COLMAP_FILE_MISSING SCENE_LAYOUT SCENE_UNKNOWN SCENE_ARGUMENT SCENE_IMAGE_MISSING
        SCENE_IMAGE_RESIZED SCENE_IMAGE SCENE_PRINCIPAL_POINT CAPTURE_FAILED
    """)


class MeshFileError(MsbError):
    """A mesh file is invalid."""

    codes = _names("""
        MESH_FILE_INVALID MESH_FILE_TRUNCATED MESH_FILE_LEFT_OUT MESH_FILE_UNSUPPORTED MESH_FILE_TOO_LARGE
    """)


class MeshError(MsbError):
    """Arrays do not form a valid mesh."""

    codes = _names("MESH_ARRAY MESH_INDEX_OUT_OF_RANGE MESH_NONFINITE MESH_ORIGIN MESH_ROUNDED WELD_DISTANCE")


class MetricError(MsbError):
    """A metric cannot be computed from the given images, meshes, weights or datasets."""

    codes = _names("""
        METRIC_IMAGE METRIC_SIZES_DIFFER METRIC_IMAGE_ALPHA METRIC_IMAGE_NAMES METRIC_WEIGHTS
        METRIC_VGG_UNKNOWN METRIC_MESH METRIC_DTU METRIC_FAILED METRIC_NOTHING_SHOWN METRIC_ARGUMENT
    """)


class OutputError(MsbError):
    """An output cannot be written."""

    codes = _names("OUTPUT_UNWRITABLE OUTPUT_FORMAT_LIMIT")


class Unsupported(MsbError):
    """The method does not support this tier or format. The error message gives the reason."""

    codes = _names("""
        UNSUPPORTED_METHOD UNSUPPORTED_TIER UNSUPPORTED_CAMERA UNSUPPORTED_OPTION UNSUPPORTED_REPAIR
        PEER_FAILED
    """)


class DeviceError(MsbError):
    """No OpenCL device exists, or the device fails: too little memory, or a kernel that does not compile."""

    codes = _names("""
        DEVICE_NOT_FOUND DEVICE_MEMORY DEVICE_BUILD DEVICE_COMMAND ENGINE_FAILED DEVICE_CLOSED
        RUN_WORKER_DIED
    """)


EXIT_OK = 0
EXIT_INTERRUPTED = 130
# Maps each class of errors to the exit status of the command line. The help of every command lists these exit
# statuses.
EXIT_STATUS: dict[type[MsbError], int] = {
    GateFailed: 1,
    UsageError: 2,
    InputError: 3,
    AssetError: 3,
    CheckpointError: 3,
    SceneError: 3,
    MeshFileError: 3,
    MeshError: 3,
    MetricError: 3,
    OutputError: 3,
    Unsupported: 4,
    DeviceError: 5,
}


class Code(NamedTuple):
    """The explanation of an error code: its class, a summary, and the remedy."""

    kind: type[MsbError]
    summary: str
    remedy: str


@dataclass(frozen=True)
class Finding:
    """A problem that `validate` reports.

    `pointer` is a JSON pointer into the manifest, an array element or a byte offset. `file` is a file inside
    the asset, if the location of the problem is known.
    """

    code: str
    severity: Severity
    message: str
    pointer: str | None = None
    file: str | None = None
    value: Any = None
    limit: Any = None

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as JSON data. Unknown fields of the finding are None."""
        return {
            "code": self.code,
            "severity": self.severity,
            "message": self.message,
            "pointer": self.pointer,
            "file": self.file,
            "value": json_safe(self.value),
            "limit": json_safe(self.limit),
        }

    def to_line(self, path: object) -> str:
        """Return the line that a command prints for a warning or info about the file at `path`."""
        word = "note" if self.severity == "info" else "warning"
        return f"{word}: {self.code}: {path}: {self.message}"

    def to_error(self, path: object) -> MsbError:
        """Convert this finding to an exception about the asset at `path`."""
        return error_kind(self.code)(self.code, self.message, file=path, pointer=self.pointer)


def finding(
    code: str,
    message: str,
    *,
    severity: Severity = "error",
    pointer: str | None = None,
    file: str | None = None,
    value: Any = None,
    limit: Any = None,
) -> Finding:
    """Return a `Finding`. Raises KeyError if no class has the code."""
    error_kind(code)
    return Finding(code, severity, one_line(message), pointer, file, value, limit)


def error_finding(error: MsbError) -> Finding:
    """Return an error as a finding. This function is the inverse of `Finding.to_error`."""
    return finding(error.code, error.message, pointer=error.pointer)


def json_safe(value: Any) -> Any:
    """Return `value` as JSON data. Long text is shortened, and values of other types become text.

    NaN and infinity become text, such as "nan", because JSON has no such numbers.
    """
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else repr(value)
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value[:16]]
    return shorten(str(value))


def shorten(text: str, limit: int = 80) -> str:
    """Return `text` on one line, without control characters and with at most `limit` characters.

    Error messages can quote a malicious file, and must not be able to control a terminal.
    """
    clean = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text[: limit + 1])
    return clean if len(clean) <= limit else clean[: limit - 3] + "..."


@contextlib.contextmanager
def about(path: object) -> Iterator[None]:
    """Add the file `path` to errors in the block that name no file."""
    try:
        yield
    except MsbError as error:
        if error.file is not None or path is None:
            raise
        raise error.at(path) from error


def one_line(text: str) -> str:
    """Return `text` with control characters escaped, so that it stays on one line."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def formula_safe(text: str) -> str:
    """Return `text` as a CSV cell that spreadsheets do not evaluate: an apostrophe is put before a formula.

    A spreadsheet formula begins with = + - @, a tab or a line break. Numbers and "--" are returned unchanged.
    Quotation marks would not prevent evaluation, because spreadsheets remove them first. Source: OWASP, "CSV
    Injection".
    """
    harmless = re.fullmatch(r"--|[+-]?[\d.]+", text)
    return text if harmless or not text.startswith(tuple("=+-@\t\r\n")) else f"'{text}"


def error_kind(code: str) -> type[MsbError]:
    """Return the class of a code. Raise KeyError if no class has the code."""
    for kind in EXIT_STATUS:
        if code in kind.codes:
            return kind
    raise KeyError(code)


@cache
def explained_codes() -> dict[str, Code]:
    """Return the explanations of errors.toml by code, for the docs and `msb validate --explain`."""
    tables = tomllib.loads(resources.files("msb").joinpath("errors.toml").read_text(encoding="utf-8"))
    return {name: Code(error_kind(name), **texts) for name, texts in tables.items()}
