"""The error tree, the codes of each class, and the table from class to exit status.

Every failure a user can cause has one stable code. A code belongs to exactly one class, a class to
exactly one exit status. The command line prints ``CODE: FILE: what is wrong, where, what would be right``.
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
    """Any failure MeshSplatBench reports on purpose.

    Parameters
    ----------
    code : str
        Stable name; it must be one of the `codes` of this class.
    message : str
        What is wrong, where, and what would be right. One sentence or two, no line break needed.
    file : str, optional
        The file or folder at fault.
    pointer : str, optional
        JSON pointer, byte offset ("byte 128"), line ("line 7") or array element ("indices[12, 0]").
    """

    codes: ClassVar[frozenset[str]] = frozenset()
    """The codes of this class; errors.toml explains them."""

    @property
    def exit_status(self) -> int:
        """What the command line ends with."""
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
            raise TypeError(f"{code} is no code of {type(self).__name__}")
        self.code = code
        self.message = one_line(message)
        self.file = None if file is None else str(file)
        self.pointer = pointer
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        # The default would call the class with the printed text alone; a worker process must be able to
        # send its error home.
        return partial(type(self), file=self.file, pointer=self.pointer), (self.code, self.message)

    def at(self, file: object) -> Self:
        """Return this error as one about `file`."""
        return type(self)(self.code, self.message, file=file, pointer=self.pointer)

    def __str__(self) -> str:
        where = "" if self.file is None else f"{one_line(self.file)}: "
        return f"{self.code}: {where}{self.message}"


class GateFailed(MsbError):
    """A gate the user asked for did not hold."""

    codes = _names("GATE_FAILED CROSS_CHECK_DISAGREES")


class UsageError(MsbError):
    """The command or call was put wrongly; the inputs were not at fault."""

    codes = _names("""
        USAGE EXTRA_MISSING VIEW_NO_DISPLAY OUTPUT_EXISTS RESULTS_MIXED NAME_UNKNOWN
        DEVICE_SELECTOR SETTING_UNKNOWN SETTING_VALUE PACKAGE_LEFT_OUT RESULTS_BUSY
        RUN_SCHEDULER ENGINE_MISSING
    """)


class InputError(MsbError):
    """An input does not exist, cannot be read or is not one of ours."""

    codes = _names("""
        FILE_NOT_FOUND FILE_UNREADABLE FILE_NOT_RECOGNISED RECORD_INVALID RESULTS_EMPTY RENDERS_CHANGED
        TRAINING_FAILED PROTOCOL_INVALID
    """)


class AssetError(MsbError):
    """A `.triasset` breaks its contract."""

    codes = _names("""
        TRIASSET_MANIFEST_MISSING TRIASSET_MANIFEST TRIASSET_VERSION_UNSUPPORTED TRIASSET_VERSION_NEWER
        TRIASSET_FIELD TRIASSET_FIELD_UNKNOWN TRIASSET_METHOD_NOT_INSTALLED TRIASSET_EMPTY TRIASSET_BOUNDS
        TRIASSET_PATH TRIASSET_FILE_UNREADABLE TRIASSET_FILE_UNDECLARED TRIASSET_BUFFER TRIASSET_DAMAGED
        TRIASSET_FORM TRIASSET_HOSTILE TRIASSET_VALUE_NONFINITE TRIASSET_VALUE_RANGE
        TRIASSET_INDEX_OUT_OF_RANGE TRIASSET_FACE_REPEATED_INDEX TRIASSET_FACE_DUPLICATE
        TRIASSET_FACE_ZERO_AREA TRIASSET_VERTEX_UNREFERENCED
    """)


class CheckpointError(MsbError):
    """A trained checkpoint (.pt, .ckpt) is broken, hostile or of a kind that is not read."""

    codes = _names("""
        CHECKPOINT_NOT_RECOGNISED CHECKPOINT_DAMAGED CHECKPOINT_HOSTILE CHECKPOINT_FORM CHECKPOINT_UNKNOWN
        CHECKPOINT_METHOD CHECKPOINT_FILE_MISSING CHECKPOINT_LAYOUT CHECKPOINT_NONFINITE CHECKPOINT_ROUNDED
        CHECKPOINT_CONFIG_MISSING CHECKPOINT_CONFIG
    """)


class SceneError(MsbError):
    """A camera, or a file of cameras or of a reconstruction, is not valid."""

    codes = _names("""
        CAMERA_INVALID CAMERA_PATH CAMERA_SOURCE CAMERA_NONE CAMERA_DISTORTED CAMERA_IMAGE CAMERA_FILE
        COLMAP_INVALID COLMAP_FILE_MISSING SCENE_LAYOUT SCENE_UNKNOWN SCENE_ARGUMENT SCENE_IMAGE_MISSING
        SCENE_IMAGE_RESIZED SCENE_IMAGE SCENE_PRINCIPAL_POINT
    """)


class MeshFileError(MsbError):
    """A foreign mesh file is not valid."""

    codes = _names("""
        MESH_FILE_INVALID MESH_FILE_TRUNCATED MESH_FILE_LEFT_OUT MESH_FILE_UNSUPPORTED MESH_FILE_TOO_LARGE
    """)


class MeshError(MsbError):
    """Arrays given as a mesh are not one."""

    codes = _names("MESH_ARRAY MESH_INDEX_OUT_OF_RANGE MESH_NONFINITE WELD_DISTANCE")


class MetricError(MsbError):
    """Images, meshes, weights or data sets that a metric cannot be computed from."""

    codes = _names("""
        METRIC_IMAGE METRIC_SIZES_DIFFER METRIC_IMAGE_ALPHA METRIC_IMAGE_NAMES METRIC_WEIGHTS
        METRIC_VGG_UNKNOWN METRIC_MESH METRIC_DTU METRIC_FAILED METRIC_NOTHING_SHOWN METRIC_ARGUMENT
    """)


class OutputError(MsbError):
    """An output cannot be written."""

    codes = _names("OUTPUT_UNWRITABLE OUTPUT_FORMAT_LIMIT")


class Unsupported(MsbError):
    """The method does not support this tier or format; the message names method, tier and reason."""

    codes = _names("""
        UNSUPPORTED_METHOD UNSUPPORTED_TIER UNSUPPORTED_CAMERA UNSUPPORTED_OPTION UNSUPPORTED_REPAIR
        PEER_FAILED
    """)


class DeviceError(MsbError):
    """No OpenCL device, too little memory on it, or a kernel that does not build."""

    codes = _names("""
        DEVICE_NOT_FOUND DEVICE_MEMORY DEVICE_BUILD DEVICE_COMMAND ENGINE_FAILED DEVICE_CLOSED
        RUN_WORKER_DIED
    """)


EXIT_OK = 0
EXIT_INTERRUPTED = 130
# Class of failure -> exit status of the command line, as the help of every command ends with.
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
    """What a code means: the class that carries it, one line of explanation, and the remedy."""

    kind: type[MsbError]
    summary: str
    remedy: str


@dataclass(frozen=True)
class Finding:
    """One thing `validate` found.

    `pointer` is a JSON pointer into the manifest, an array element or a byte offset; `file` is the member
    or file inside the asset, when that is more precise than the asset itself.
    """

    code: str
    severity: Severity
    message: str
    pointer: str | None = None
    file: str | None = None
    value: Any = None
    limit: Any = None

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as plain JSON data; what is unknown is null."""
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
        """Return what a command prints of the finding, which is no error, about the file at `path`."""
        word = "note" if self.severity == "info" else "warning"
        return f"{word}: {self.code}: {path}: {self.message}"

    def to_error(self, path: object) -> MsbError:
        """Return the exception that stands for this finding about the asset at `path`."""
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
    """Make a `Finding` of a registered code; KeyError if no class has it."""
    error_kind(code)
    return Finding(code, severity, one_line(message), pointer, file, value, limit)


def error_finding(error: MsbError) -> Finding:
    """Return the finding that says what `error` says; the reverse of `Finding.to_error`."""
    return finding(error.code, error.message, pointer=error.pointer)


def json_safe(value: Any) -> Any:
    """Return `value` as JSON can hold it: no NaN, no foreign types, long text shortened.

    A non-finite float becomes its name as text, so that a report never carries a bare NaN token.
    """
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else repr(value)
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value[:16]]
    return shorten(str(value))


def shorten(text: str, limit: int = 80) -> str:
    """Return `text` printable on one line and at most `limit` characters long.

    A hostile file must not be able to flood or repaint the terminal through its own error message.
    """
    clean = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text[: limit + 1])
    return clean if len(clean) <= limit else clean[: limit - 3] + "..."


@contextlib.contextmanager
def about(path: object) -> Iterator[None]:
    """Give errors about arrays, which know no file, the name of the file the arrays came from."""
    try:
        yield
    except MsbError as error:
        if error.file is not None or path is None:
            raise
        raise error.at(path) from error


def one_line(text: str) -> str:
    """Return `text` without control characters: a file's name or content must not break the line."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def formula_safe(text: str) -> str:
    """Return `text` as a cell of a CSV file that no spreadsheet runs: formulas with an apostrophe before.

    These begin with one of = + - @, a tab or the end of a line; numbers and "--" stay. Quotation marks would
    not help. Source: OWASP, "CSV Injection".
    """
    harmless = re.fullmatch(r"--|[+-]?[\d.]+", text)
    return text if harmless or not text.startswith(tuple("=+-@\t\r\n")) else f"'{text}"


def error_kind(code: str) -> type[MsbError]:
    """Return the class that a code is registered for; KeyError if none has it."""
    for kind in EXIT_STATUS:
        if code in kind.codes:
            return kind
    raise KeyError(code)


@cache
def explained_codes() -> dict[str, Code]:
    """Return what every code means: errors.toml, for the docs and `msb validate --explain`."""
    tables = tomllib.loads(resources.files("msb").joinpath("errors.toml").read_text(encoding="utf-8"))
    return {name: Code(error_kind(name), **texts) for name, texts in tables.items()}
