"""The error tree, the registry of codes, and the table from class to exit status.

Every failure a user can cause has one stable code. A code belongs to exactly one class, a class to
exactly one exit status. The command line prints ``CODE: FILE: what is wrong, where, what would be right``.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

Severity = Literal["error", "warning", "info"]


class MsbError(Exception):
    """Any failure MeshSplatBench reports on purpose.

    Parameters
    ----------
    code : str
        Stable name from `CODES`; it must be registered for this class.
    message : str
        What is wrong, where, and what would be right. One sentence or two, no line break needed.
    file : str, optional
        The file or folder at fault.
    pointer : str, optional
        JSON pointer, byte offset ("byte 128"), line ("line 7") or array element ("indices[12, 0]").
    value, limit : optional
        What was found and what is allowed.
    """

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
        value: Any = None,
        limit: Any = None,
    ) -> None:
        if CODES[code].kind is not type(self):
            text = f"{code} is registered for {CODES[code].kind.__name__}, not {type(self).__name__}"
            raise TypeError(text)
        self.code = code
        self.message = one_line(message)
        self.file = None if file is None else str(file)
        self.pointer = pointer
        self.value = value
        self.limit = limit
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        # The default would call the class with the printed text alone; a worker process must be able to
        # send its error home.
        where = {key: getattr(self, key) for key in ("file", "pointer", "value", "limit")}
        return partial(type(self), **where), (self.code, self.message)

    def __str__(self) -> str:
        where = "" if self.file is None else f"{one_line(self.file)}: "
        return f"{self.code}: {where}{self.message}"


class GateFailed(MsbError):
    """A gate the user asked for did not hold."""


class UsageError(MsbError):
    """The command or call was put wrongly; the inputs were not at fault."""


class InputError(MsbError):
    """An input does not exist, cannot be read or is not one of ours."""


class AssetError(MsbError):
    """A `.triasset` breaks its contract."""


class CheckpointError(MsbError):
    """A trained checkpoint (.pt, .ckpt) is broken, hostile or of a kind that is not read."""


class SceneError(MsbError):
    """A camera, or a file of cameras or of a reconstruction, is not valid."""


class MeshFileError(MsbError):
    """A foreign mesh file is not valid."""


class MeshError(MsbError):
    """Arrays given as a mesh are not one."""


class MetricError(MsbError):
    """Images, meshes, weights or data sets that a metric cannot be computed from."""


class OutputError(MsbError):
    """An output cannot be written."""


class Unsupported(MsbError):
    """The method does not support this tier or format; the message names method, tier and reason."""


class DeviceError(MsbError):
    """No OpenCL device, too little memory on it, or a kernel that does not build."""


EXIT_OK = 0
EXIT_INTERRUPTED = 130
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
"""Class of failure -> exit status of the command line, as the help of every command ends with."""


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
        return CODES[self.code].kind(
            self.code, self.message, file=path, pointer=self.pointer, value=self.value, limit=self.limit
        )


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
    """Make a `Finding` of a registered code.

    Raises
    ------
    KeyError
        The code is not in `CODES`.
    """
    if code not in CODES:
        raise KeyError(code)
    return Finding(code, severity, one_line(message), pointer, file, value, limit)


def error_finding(error: MsbError) -> Finding:
    """Return the finding that says what `error` says; the reverse of `Finding.to_error`."""
    return finding(error.code, error.message, pointer=error.pointer, value=error.value, limit=error.limit)


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
        where = {"pointer": error.pointer, "value": error.value, "limit": error.limit}
        raise type(error)(error.code, error.message, file=path, **where) from error


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


def _codes(kind: type[MsbError], table: dict[str, tuple[str, str]]) -> dict[str, Code]:
    return {name: Code(kind, summary, remedy) for name, (summary, remedy) in table.items()}


_EXPORT_AGAIN = "Export the asset again from its checkpoint or mesh."
_FIX_MANIFEST = "Correct manifest.json (docs/triasset.md lists every key) or export the asset again."
_SAVE_AGAIN = "Load it where it was trained and save it again with torch.save, as plain tensors and dicts."
_COPY_AGAIN = "Copy or download the file again."
_HOSTILE = "torch.save does not write this: find out where the file comes from."
_OTHER_LAYOUT = "The file is damaged or of another version of the method's code than docs/export.md names."
_FIX_CAMERA = "Correct the camera; docs/cameras.md has the conventions."
_FIX_CAMERAS = "Correct the file; docs/cameras.md has the rules of its format."
_FIX_COLMAP = "Write the model again with COLMAP's model_converter."
_FIX_MESH = "Export the mesh again from the program that wrote it."
_FIX_DTU = "Take the file from the official DTU MVS 2014 archives; docs/metrics.md lists them."

CODES: dict[str, Code] = {
    **_codes(
        GateFailed,
        {
            "GATE_FAILED": (
                "A condition of --fail-on or of the --profile holds, or a trial of --fail-on failed.",
                "Look at the sample elements of the audit, repair the mesh, or relax the condition.",
            ),
            "WEB_UNFAITHFUL": (
                "A page of the dedicated tier shows a test view less faithfully than --at-least asks for.",
                "Compare browsers and graphics cards; a page with --quantise or --faces needs a lower bar.",
            ),
            "BENCH_SLOWER": (
                "It is slower than --fail-slower allows.",
                "Measure again on an idle machine, look at the stages, or allow more.",
            ),
            "CROSS_CHECK_DISAGREES": (
                "A peer library counts differently although its definition is ours.",
                "This is a bug in one of the two: report it with the mesh.",
            ),
        },
    ),
    **_codes(
        UsageError,
        {
            "USAGE": (
                "The command line is not one we understand, or a call has an argument of the wrong kind.",
                "See --help, which shows an example, or the function's docstring.",
            ),
            "CONFIG_INVALID": (
                "A file or variable sets what no option is called, or to what it cannot be.",
                "Correct the file or variable named; msb config show --all lists what can be set.",
            ),
            "EXTRA_MISSING": (
                "The command needs a library that is not installed.",
                "Install the extra named in the message.",
            ),
            "VIEW_NO_GL": (
                "VTK has nothing to draw with: no display, no EGL, no OSMesa.",
                "Install one of the packages the message names, or write a page with --html.",
            ),
            "VIEW_NO_DISPLAY": (
                "There is no display to open a window on.",
                "Give --screenshot, --html or --figure, which need none.",
            ),
            "VIEW_ELEMENT": (
                "There is no layer, element, vertex or component of that name or number.",
                "The message says what there is.",
            ),
            "VIEW_TIER": (
                "There is no tier of that name, or it has no picture to compare.",
                "The message says what there is to compare: truth, reference, dedicated, standard.",
            ),
            "OUTPUT_EXISTS": (
                "The output exists and --force was not given.",
                "Give --force (overwrite=True in Python) or another name.",
            ),
            "RESULTS_MIXED": (
                "Results that would stand beside each other differ in a metric's definition, setup or asset.",
                "Report them apart or run the older ones again; --allow-mixed takes them and says so.",
            ),
            "TABLE_UNKNOWN": (
                "The report has no table of that label.",
                "The message lists the labels.",
            ),
            "EXPLAIN_UNKNOWN": (
                "There is no quantity or code of that name.",
                "The message lists the nearest names.",
            ),
            "DEVICE_SELECTOR": (
                "What was given as the device does not name one.",
                "Give cpu, gpu or PLATFORM:INDEX; msb devices lists what there is.",
            ),
            "SETTING_UNKNOWN": (
                "The method has no setting of that name.",
                "The message lists those it has; so does msb methods.",
            ),
            "SETTING_VALUE": (
                "A setting was given a value it cannot take.",
                "The message says what it takes; so does msb methods.",
            ),
            "CAMERA_UNKNOWN": (
                "There is no camera of that name or number, or several.",
                "The message lists some; names are those of the images.",
            ),
            "METHOD_NOT_LOADED": (
                "A package's method is left out: it cannot be loaded, it fails, or its name is taken.",
                "Update or remove the package; the other methods work as before.",
            ),
            "RENDERER_NOT_LOADED": (
                "A package's renderer is left out: its name is taken.",
                "Remove one of the packages; the other renderers work as before.",
            ),
            "METRIC_NOT_LOADED": (
                "A package's metric is left out: it cannot be loaded, it is none, or its name is taken.",
                "Update or remove the package; the other metrics work as before.",
            ),
            "PACKAGE_PRINTS": (
                "A package with a method, renderer or metric prints when it is imported.",
                "Nothing is wrong: what it prints is kept out of the result. Tell its authors.",
            ),
            "RENDERER_UNKNOWN": (
                "There is no renderer of that name.",
                "The message lists those there are; others come with packages that bring one.",
            ),
            "RESULTS_BUSY": (
                "Another msb run is writing into the results folder.",
                "Wait for it or stop it; the message says where it runs.",
            ),
            "RUN_PATH_NAME": (
                "The name of a file or folder of the run is not UTF-8, as records are.",
                "Rename it, or run in another folder.",
            ),
            "RUN_SCHEDULER": (
                "There is no Dask scheduler at that address, or it was lost.",
                "Start one with dask scheduler; docs/protocol.md has the commands.",
            ),
            "RUN_WORKER_PATHS": (
                "A worker on another machine does not see the files of the run.",
                "Mount results, scenes and models under the same paths on every machine.",
            ),
            "ENGINE_MISSING": (
                "The engine that is to draw is not installed.",
                "The message says what to install; so do docs/engines.md and msb devices.",
            ),
            "OFFICIAL_FORMAT": (
                "The method's own exporter does not write that format.",
                "The message names the formats it writes.",
            ),
        },
    ),
    **_codes(
        DeviceError,
        {
            "DEVICE_NOT_FOUND": (
                "There is no device to compute on, or none of the kind or platform asked for.",
                "msb devices lists what there is; docs/opencl.md and docs/engines.md say how to get more.",
            ),
            "DEVICE_MEMORY": (
                "A buffer does not fit into the device.",
                "Choose a device with more memory, or a smaller image or asset.",
            ),
            "DEVICE_BUILD": (
                "A kernel does not build for the device, or no device that was meant builds any.",
                'After "unknown target CPU" the platform\'s compiler is older than the processor: install a '
                "newer PoCL or Intel's runtime (docs/opencl.md). msb devices tries every device and says "
                "what to do. Where a line of a kernel is named, report it with what --debug shows.",
            ),
            "DEVICE_LIMIT": (
                "A kernel needs larger work-groups than the device allows for it.",
                "Take another device: msb devices lists what there is, a CPU allows all that is needed.",
            ),
            "DEVICE_COMMAND": (
                "The device refused or failed a command.",
                "Try another device; if it stays, report it with what --debug shows.",
            ),
            "ENGINE_FAILED": (
                "A foreign engine, or the renderer of a package, refused, ended or does not answer.",
                "The message has its last words; docs/engines.md lists what is known to go wrong.",
            ),
            "DEVICE_CLOSED": (
                "A device or buffer was used after it was closed.",
                "Use it inside its with block.",
            ),
            "RUN_WORKER_DIED": (
                "The process that computed a cell died: out of memory, or a crash of the OpenCL platform.",
                "Run again with fewer --jobs, or on another device.",
            ),
        },
    ),
    **_codes(
        OutputError,
        {
            "OUTPUT_UNWRITABLE": (
                "The output cannot be written.",
                "Check that the folder exists, is writable and has room.",
            ),
            "OUTPUT_COORDINATES": (
                "A coordinate is not finite or does not fit the output's number format.",
                "Repair the mesh first; msb-audit names the vertices.",
            ),
            "OUTPUT_FORMAT_LIMIT": (
                "The output's format cannot hold this mesh.",
                "Choose another format; PLY holds any mesh.",
            ),
        },
    ),
    **_codes(
        Unsupported,
        {
            "UNSUPPORTED_STANDARD": (
                "The method has no static colour, so the standard tier cannot show it.",
                "Use the dedicated tier.",
            ),
            "UNSUPPORTED_METHOD": (
                "Models of this method are not made of triangles, so they cannot be exported.",
                "Extract a mesh with the method's own tools, and give that.",
            ),
            "UNSUPPORTED_TIER": (
                "The method cannot be drawn on this tier.",
                "The message says why; msb methods lists the tiers of each method.",
            ),
            "UNSUPPORTED_CAMERA": (
                "The engine has no such camera.",
                "The message says what the engine takes; our own renderers take any camera.",
            ),
            "UNSUPPORTED_OPTION": (
                "What draws this method on this tier has no such option.",
                "The message lists the options there are; orders and samplings: docs/dedicated.md.",
            ),
            "UNSUPPORTED_REPAIR": (
                "A buffer's values do not follow from the old ones when a repair turns or adds faces.",
                "Leave out the step that the message names; docs/repair.md says what can be carried.",
            ),
            "PEER_FAILED": (
                "Another library crashed, did not answer in time or took too much memory.",
                "Use our own steps, or allow more with --seconds and --memory.",
            ),
            "UNSUPPORTED_OFFICIAL": (
                "The method has no exporter of its own.",
                "Leave out --official to get the standard-tier mesh.",
            ),
        },
    ),
    **_codes(
        InputError,
        {
            "FILE_NOT_FOUND": ("The path does not exist.", "Check the spelling."),
            "FILE_UNREADABLE": (
                "The path exists but cannot be read as a regular file or folder.",
                "Check its permissions; pipes and devices are not read.",
            ),
            "FILE_NAMES_ALIKE": (
                "Two files of a folder have one name, spelled in two Unicode normal forms (NFC and NFD).",
                "Leave one of them; archives made on macOS bring the second.",
            ),
            "FILE_NOT_RECOGNISED": (
                "Neither the name nor the content is of a kind we read.",
                "Give a .triasset, a mesh file (docs/meshes.md has the formats), or a folder of these.",
            ),
            "RECORD_INVALID": (
                "A result record is not one of ours, or was changed by hand.",
                "The message names the key; docs/protocol.md has all of them. Run the cell again.",
            ),
            "RECORD_MISPLACED": (
                "A result record is not of the cell in whose place it lies.",
                "Move it to cells/DATASET/SCENE/METHOD/CONDITION as its cell says, or run the cell again.",
            ),
            "RESULTS_EMPTY": (
                "The folder holds no result records.",
                "Give the folder that msb run wrote: cells/DATASET/SCENE/METHOD/CONDITION/result.json.",
            ),
            "RENDERS_CHANGED": (
                "An official rendering is not what the folder's SHA256SUMS says.",
                "Copy the folder again, or write the list again with sha256sum.",
            ),
            "TRAINING_FAILED": (
                "The record of a training says that the training failed.",
                "Train again under msb track; the status is in the record.",
            ),
            "PROTOCOL_INVALID": (
                "A protocol file (TOML) has an unknown key or a value that cannot be.",
                "The message names the key and what it takes; docs/protocol.md has all of them.",
            ),
        },
    ),
    **_codes(
        MeshError,
        {
            "MESH_ARRAY": (
                "Vertices or faces do not have the shape or type of a triangle mesh.",
                "Vertices are (V, 3) numbers, faces (F, 3) integers.",
            ),
            "MESH_INDEX_OUT_OF_RANGE": (
                "A face uses a vertex that does not exist.",
                "Indices run from 0 to V - 1; a negative index is never wrapped.",
            ),
            "MESH_TOO_LARGE": (
                "More vertices or faces than 32-bit element numbers can hold.",
                "Split the mesh.",
            ),
            "MESH_NONFINITE": (
                "A coordinate is NaN or infinite where geometry is computed.",
                "Remove or correct the vertex that the message names; the audit counts such faces.",
            ),
            "WELD_DISTANCE": (
                "The weld distance is not a positive finite length.",
                "Give --weld exact or a positive length in the units of the mesh.",
            ),
            "WELD_TOO_WIDE": (
                "The weld distance joins so many vertex pairs that it would collapse the mesh.",
                "Give a distance well below the typical edge length.",
            ),
        },
    ),
    **_codes(
        MeshFileError,
        {
            "MESH_FILE_HEADER": ("The header is missing or says something impossible.", _FIX_MESH),
            "MESH_FILE_TRUNCATED": ("The file ends before all declared elements.", _FIX_MESH),
            "MESH_FILE_TRAILING": ("There is data after the last declared element.", _FIX_MESH),
            "MESH_FILE_NUMBER": ("A number cannot be read.", _FIX_MESH),
            "MESH_FILE_FACE": ("A face list is malformed.", _FIX_MESH),
            "MESH_FILE_INDEX": ("A face uses a vertex that the format does not allow.", _FIX_MESH),
            "MESH_FILE_LEFT_OUT": (
                "The file holds more than triangles and their colours, such as textures, UVs or normals; "
                "that is not read, and so not written either.",
                "Nothing, if you want the triangles. Keep the original file for the rest.",
            ),
            "MESH_FILE_UNSUPPORTED": (
                "The file uses a feature of its format that we do not read.",
                "Export without it; the message names it.",
            ),
            "MESH_FILE_TOO_LARGE": (
                "The file declares more than it can hold or than we accept.",
                _FIX_MESH,
            ),
        },
    ),
    **_codes(
        MetricError,
        {
            "METRIC_IMAGE_SHAPE": (
                "An image is not height x width x 3, or has no pixels.",
                "Give RGB; composite alpha over a background first.",
            ),
            "METRIC_IMAGE_DTYPE": (
                "An image is neither uint8 nor floating point.",
                "Give bytes, or floats in [0, 1].",
            ),
            "METRIC_IMAGE_VALUE": (
                "An image holds NaN, infinity or masked values, or floats that are bytes in disguise.",
                "Give floats in [0, 1]; divide bytes by 255.",
            ),
            "METRIC_SIZES_DIFFER": (
                "The two images differ in size.",
                "Render at the size of the ground truth; nothing is resized here.",
            ),
            "METRIC_IMAGE_TOO_SMALL": (
                "LPIPS halves the image four times, so each side needs 16 pixels.",
                "Leave LPIPS out for such images.",
            ),
            "METRIC_IMAGE_FILE": (
                "An image file is damaged, too large or of a kind that is not evaluated.",
                "Give 8-bit RGB PNG or JPEG, or float .npy or .exr as msb render writes them.",
            ),
            "METRIC_IMAGE_ALPHA": (
                "An image is partly transparent and no background was given.",
                "Give --background; the same for both folders.",
            ),
            "METRIC_IMAGE_NAMES": (
                "The two folders do not hold the same images.",
                "The message names them; --subset lets GT hold more than PRED.",
            ),
            "METRIC_VGG_WEIGHTS": (
                "The file does not hold the weights of torchvision's VGG16.",
                "docs/metrics.md says which file it is and where it comes from.",
            ),
            "METRIC_VGG_UNKNOWN": (
                "The VGG16 weights are not the published ones: LPIPS compares with nothing published.",
                "Use vgg16-397923af.pth; docs/metrics.md says where it comes from.",
            ),
            "METRIC_LPIPS_HEADS": (
                "The installed lpips package does not bring the linear layers of version 0.1.",
                "Install lpips 0.1.4.",
            ),
            "METRIC_MESH": (
                "The mesh or points cannot be evaluated: wrong shape, index or coordinate.",
                "Vertices are (V, 3) finite numbers, faces (F, 3) indices below V.",
            ),
            "METRIC_MESH_SCALE": (
                "Sampling the surface every 0.2 mm would take far too many points.",
                "The mesh must be culled and in the millimetres of DTU.",
            ),
            "METRIC_DTU_FILE": ("A file of the DTU evaluation data is not what it must be.", _FIX_DTU),
            "METRIC_DTU_VIEWS": (
                "The matrices or masks of a DTU scan cannot be used for culling.",
                "Give one 4 x 4 world_mat, scale_mat and one mask for each view.",
            ),
            "METRIC_FAILED": (
                "A package's metric fails on an image, or gives no finite number; the others are measured.",
                "Update or remove the package the message names.",
            ),
            "METRIC_NOTHING_SHOWN": (
                "No view of a condition shows a pixel of the model, so no number says how it looks.",
                "Give the scene that the model was trained on, or a model in the scene's coordinates.",
            ),
            "METRIC_ARGUMENT": (
                "An argument of a metric is out of range.",
                "The message says what it takes.",
            ),
        },
    ),
    **_codes(
        SceneError,
        {
            # --- one camera
            "CAMERA_SIZE": ("The size of the image is not one an image can have.", _FIX_CAMERA),
            "CAMERA_FOCAL": ("A focal length or field of view is not positive and finite.", _FIX_CAMERA),
            "CAMERA_PRINCIPAL_POINT": (
                "The principal point is not finite or absurdly far away.",
                _FIX_CAMERA,
            ),
            "CAMERA_MATRIX": ("The pose is not a finite 4 x 4 matrix with last row 0 0 0 1.", _FIX_CAMERA),
            "CAMERA_ROTATION": (
                "The pose holds more than a rotation: a scale, a shear or a mirror image.",
                "Remove the scale; to change axes negate two of them, not one.",
            ),
            "CAMERA_NAME": (
                "The name could not be the name of a file below a folder.",
                "Use a relative path with forward slashes, without '..' and control characters.",
            ),
            "CAMERA_SPLIT": ("The split is not one we know.", "Use train, val or test, or none."),
            "CAMERA_LOOK_AT": (
                "The points and the direction do not say how the camera is turned.",
                "Eye and target must differ, and up must not be along the line between them.",
            ),
            "CAMERA_PATH": (
                "A camera path cannot be made from what was given.",
                "The message says what is needed.",
            ),
            # --- where cameras are looked for
            "CAMERA_SOURCE": (
                "Neither a file nor a folder of a kind that cameras are read from.",
                "Give a COLMAP folder, a transforms_*.json, a cameras.json or a views.json.",
            ),
            "CAMERA_NONE": ("There is no camera in it.", "Give a file with at least one."),
            "CAMERA_TOO_MANY": ("There are more cameras than we accept.", "Split the model."),
            "CAMERA_DUPLICATE": ("Two cameras have the same name or id.", "Rename one of them."),
            "CAMERA_DISTORTED": (
                "The camera is not a pinhole camera: its lens distorts.",
                "Undistort the images first, for instance with COLMAP's image_undistorter.",
            ),
            "CAMERA_IMAGE": (
                "The size of an image is needed, and its file is absent or no PNG or JPEG.",
                "Put the images where the file says, or give the size: w and h.",
            ),
            # --- JSON files of cameras
            "CAMERA_JSON_EMPTY": ("The file holds no bytes.", _COPY_AGAIN),
            "CAMERA_JSON_TOO_LARGE": ("The file is over 16 MiB.", "Split it."),
            "CAMERA_JSON_ENCODING": ("The file is not plain UTF-8.", _FIX_CAMERAS),
            "CAMERA_JSON_SYNTAX": ("The file is not one JSON document.", _FIX_CAMERAS),
            "CAMERA_JSON_DUPLICATE_KEY": ("An object names a key twice.", _FIX_CAMERAS),
            "CAMERA_JSON_NONFINITE": ("A number is NaN, infinite or overflows.", _FIX_CAMERAS),
            "CAMERA_JSON_TOO_DEEP": ("Objects or arrays nest too deeply.", _FIX_CAMERAS),
            "CAMERA_JSON_INTEGER": ("An integer has too many digits.", _FIX_CAMERAS),
            "CAMERA_FIELD_MISSING": ("A key that is needed is absent.", _FIX_CAMERAS),
            "CAMERA_FIELD_TYPE": ("A value has the wrong JSON type or shape.", _FIX_CAMERAS),
            "CAMERA_FIELD_VALUE": ("A value is outside what the key allows.", _FIX_CAMERAS),
            "CAMERA_FIELD_UNKNOWN": ("The format has no such key.", _FIX_CAMERAS),
            # --- COLMAP models
            "COLMAP_FILE_MISSING": (
                "The folder holds part of a COLMAP model only.",
                "cameras and images belong together, both .bin or both .txt; points3D has the points.",
            ),
            "COLMAP_TRUNCATED": ("The file ends before all it declares.", _COPY_AGAIN),
            "COLMAP_TRAILING": ("There is data after the last declared record.", _FIX_COLMAP),
            "COLMAP_LINE": ("A line has not the words it must have.", _FIX_COLMAP),
            "COLMAP_NUMBER": ("A number cannot be read.", _FIX_COLMAP),
            "COLMAP_MODEL": (
                "The camera model is not one we know.",
                "Undistort the images with COLMAP: that writes PINHOLE cameras.",
            ),
            "COLMAP_QUATERNION": ("The quaternion of an image is zero or not finite.", _FIX_COLMAP),
            "COLMAP_DUPLICATE_ID": ("Two cameras or two images have the same id.", _FIX_COLMAP),
            "COLMAP_CAMERA_ID": ("An image names a camera that does not exist.", _FIX_COLMAP),
            "COLMAP_POINT": (
                "A point is not finite, or its colour is not three numbers from 0 to 255.",
                _FIX_COLMAP,
            ),
            # --- datasets
            "SCENE_LAYOUT": (
                "The folder is not laid out as a scene of a dataset, or a part of the layout is absent.",
                "docs/datasets.md shows the layouts: sparse/0, transforms_train.json or cameras.npz.",
            ),
            "SCENE_UNKNOWN": (
                "The dataset has no such scene, or the loader no rule for the dataset.",
                "Give another dataset, or say which image folder is meant.",
            ),
            "SCENE_ARGUMENT": ("An option of a scene is out of range.", "The message says what it takes."),
            "SCENE_SPLIT": ("There is no test view or no training view.", "A scene needs some of each."),
            "SCENE_IMAGE_FOLDER": (
                "The folder of photographs that the protocol takes is not there.",
                "Download it, or name another one; results on other sizes cannot be compared.",
            ),
            "SCENE_IMAGE_MISSING": ("Photographs are not there.", "Download the scene again."),
            "SCENE_IMAGE_RESIZED": (
                "The photographs are resized here: the shipped folder of that size is absent.",
                "Download it; results on it and on resized photographs differ by up to 0.5 dB.",
            ),
            "SCENE_IMAGE_SIZE": (
                "A photograph has another size than the others, or another shape than its camera.",
                "Download the scene again, or run COLMAP's undistorter on all images at once.",
            ),
            "SCENE_IMAGE_ALPHA": (
                "The photograph of a masked dataset has no alpha channel.",
                "NeRF-Synthetic and DTU need RGBA PNG; DTU takes a folder mask instead.",
            ),
            "SCENE_MASK": (
                "The masks do not go with the photographs.",
                "There must be one mask for each photograph, of the same size, in the same order.",
            ),
            "SCENE_MATRICES": (
                "cameras.npz does not hold the projections of the views.",
                "It holds world_mat_i and scale_mat_i, 4 x 4 numbers, for every image.",
            ),
            "SCENE_PRINCIPAL_POINT": (
                "The convention gs_fov moves the principal point visibly.",
                "Use full_K for methods that were trained with the recorded one.",
            ),
        },
    ),
    **_codes(
        AssetError,
        {
            # --- the manifest as text
            "TRIASSET_MANIFEST_MISSING": ("There is no manifest.json.", _EXPORT_AGAIN),
            "TRIASSET_MANIFEST_EMPTY": ("manifest.json holds no bytes.", _EXPORT_AGAIN),
            "TRIASSET_MANIFEST_TOO_LARGE": ("manifest.json is over 1 MiB.", _FIX_MANIFEST),
            "TRIASSET_MANIFEST_ENCODING": ("manifest.json is not plain UTF-8.", _FIX_MANIFEST),
            "TRIASSET_MANIFEST_SYNTAX": ("manifest.json is not one JSON document.", _FIX_MANIFEST),
            "TRIASSET_MANIFEST_DUPLICATE_KEY": ("An object names a key twice.", _FIX_MANIFEST),
            "TRIASSET_MANIFEST_NONFINITE": ("A number is NaN, infinite or overflows.", _FIX_MANIFEST),
            "TRIASSET_MANIFEST_TOO_DEEP": ("Objects or arrays nest too deeply.", _FIX_MANIFEST),
            "TRIASSET_MANIFEST_INTEGER": ("An integer has too many digits.", _FIX_MANIFEST),
            "TRIASSET_MANIFEST_NOT_OBJECT": ("The document is not a JSON object.", _FIX_MANIFEST),
            # --- its fields
            "TRIASSET_FORMAT_UNKNOWN": ('"format" is not "triasset".', _FIX_MANIFEST),
            "TRIASSET_VERSION_MALFORMED": ('"version" is not MAJOR.MINOR.', _FIX_MANIFEST),
            "TRIASSET_VERSION_UNSUPPORTED": (
                "The major version is not one this release reads.",
                "Use a release of meshsplatbench that reads this version.",
            ),
            "TRIASSET_VERSION_NEWER": (
                "The minor version is newer: unknown keys are ignored.",
                "Upgrade meshsplatbench to see them.",
            ),
            "TRIASSET_FIELD_MISSING": ("A required key is absent.", _FIX_MANIFEST),
            "TRIASSET_FIELD_TYPE": ("A value has the wrong JSON type.", _FIX_MANIFEST),
            "TRIASSET_FIELD_VALUE": ("A value is outside what the key allows.", _FIX_MANIFEST),
            "TRIASSET_FIELD_UNKNOWN": ("The format has no such key; it is ignored.", _FIX_MANIFEST),
            "TRIASSET_METHOD_UNKNOWN": (
                '"method" is no name of a method: it must be lower-case letters, digits and underscores.',
                "msb methods lists the names; docs/triasset.md says what may be one.",
            ),
            "TRIASSET_METHOD_NOT_INSTALLED": (
                "The asset's method is not installed: the asset is audited, converted and drawn on the "
                "standard tier; its settings and its kernel are not checked.",
                "Install the package that brings the method, if its own look is wanted, or mend the name.",
            ),
            "TRIASSET_PASS_UNKNOWN": ("A required pass is not one the format names.", _FIX_MANIFEST),
            "TRIASSET_SETTING_UNKNOWN": ("The method has no setting of that name.", _FIX_MANIFEST),
            "TRIASSET_SETTING_VALUE": ("A setting has a value it cannot take.", _FIX_MANIFEST),
            "TRIASSET_COUNT_RANGE": ("A count is negative or over 2^32 - 1.", _FIX_MANIFEST),
            "TRIASSET_EMPTY": ("The asset has no vertices or no faces.", _EXPORT_AGAIN),
            "TRIASSET_SOUP_COUNT": ("A triangle soup needs exactly 3 vertices a face.", _FIX_MANIFEST),
            "TRIASSET_SH_DEGREE": ("The SH degree is not 0, 1, 2 or 3.", _FIX_MANIFEST),
            "TRIASSET_SH_WIDTH": ("f_rest does not have the width its SH degree asks for.", _FIX_MANIFEST),
            "TRIASSET_BOUNDS_INVERTED": ("bounds.min exceeds bounds.max.", _FIX_MANIFEST),
            "TRIASSET_BOUNDS_MISMATCH": ("bounds are not those of the positions.", _EXPORT_AGAIN),
            "TRIASSET_SPHERE_MISMATCH": (
                "A vertex lies outside the bounding sphere, or it is far too large.",
                _EXPORT_AGAIN,
            ),
            # --- paths and files of the asset
            "TRIASSET_PATH_UNSAFE": (
                "A buffer's file is not a plain name below buffers/.",
                'Use "buffers/NAME.bin" with letters, digits, "_", "-" and "." in NAME.',
            ),
            "TRIASSET_PATH_DUPLICATE": ("Two files differ only in upper and lower case.", _FIX_MANIFEST),
            "TRIASSET_PATH_LINK": (
                "A file of the asset is a link.",
                "Copy the data into the asset: it must be complete by itself.",
            ),
            "TRIASSET_PATH_NOT_FILE": ("A file of the asset is a folder, pipe or device.", _EXPORT_AGAIN),
            "TRIASSET_PATH_HARDLINK": (
                "A buffer file has a second name elsewhere: writing there would change this asset.",
                "Copy the file.",
            ),
            "TRIASSET_FILE_UNREADABLE": ("A file of the asset cannot be read.", "Check its permissions."),
            "TRIASSET_FILE_UNDECLARED": (
                "The asset holds a file that no buffer declares.",
                "Remove it, or declare it.",
            ),
            # --- buffers
            "TRIASSET_BUFFER_REQUIRED": ("positions or indices are not declared.", _EXPORT_AGAIN),
            "TRIASSET_BUFFER_NAME": ("A buffer's name is not one the format allows.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_MISSING": ("The file of a buffer is not there.", _EXPORT_AGAIN),
            "TRIASSET_BUFFER_TRUNCATED": ("The file of a buffer is shorter than declared.", _EXPORT_AGAIN),
            "TRIASSET_BUFFER_TOO_LONG": ("The file of a buffer is longer than declared.", _EXPORT_AGAIN),
            "TRIASSET_BUFFER_RANGE": ("offset plus byte_length is out of any file's range.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_OVERLAP": ("Two buffers share bytes of a file.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_HOLE": ("Bytes of a file belong to no buffer.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_MISALIGNED": ("A buffer does not start on a 64-byte boundary.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_DTYPE": (
                "The dtype is not float32, uint32 or uint8, or not the one this buffer has.",
                "Values are little-endian float32, uint32 or uint8.",
            ),
            "TRIASSET_BUFFER_DOMAIN": ("The first dimension is not the domain's count.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_SHAPE": ("The shape is not the one this buffer has.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_SIZE": ("shape times dtype is not byte_length.", _FIX_MANIFEST),
            "TRIASSET_BUFFER_EMPTY": ("A buffer holds nothing.", _EXPORT_AGAIN),
            "TRIASSET_CHECKSUM_MALFORMED": ("sha256 is not 64 lower-case hexadecimal digits.", _FIX_MANIFEST),
            "TRIASSET_CHECKSUM_MISMATCH": (
                "The bytes are not those the manifest was written for.",
                "Copy the asset again from its source, or export it again.",
            ),
            # --- values
            "TRIASSET_VALUE_NONFINITE": ("A buffer holds NaN or infinity.", _EXPORT_AGAIN),
            "TRIASSET_VALUE_RANGE": ("A value is outside its buffer's range.", _EXPORT_AGAIN),
            "TRIASSET_VALUE_MAGNITUDE": (
                "Coordinates are so large that areas overflow float32.",
                "Rescale the scene.",
            ),
            "TRIASSET_INDEX_OUT_OF_RANGE": ("A face uses a vertex that does not exist.", _EXPORT_AGAIN),
            "TRIASSET_SOUP_INDICES": ("The indices of a soup are not 0, 1, 2, ...", _EXPORT_AGAIN),
            "TRIASSET_FACE_REPEATED_INDEX": ("A face uses a vertex twice; it draws nothing.", "None needed."),
            "TRIASSET_FACE_DUPLICATE": ("Two faces use the same three vertices.", "None needed."),
            "TRIASSET_FACE_ZERO_AREA": ("A face has no area; it draws nothing.", "None needed."),
            "TRIASSET_VERTEX_UNREFERENCED": ("No face uses the vertex.", "None needed."),
            # --- the packed form
            "TRIASSET_ZIP_TRUNCATED": ("The end of the ZIP is missing.", "Copy the file again."),
            "TRIASSET_ZIP_DIRECTORY": ("The ZIP's central directory is not well formed.", _EXPORT_AGAIN),
            "TRIASSET_ZIP_TOO_MANY_MEMBERS": ("The ZIP has more members than an asset can.", _EXPORT_AGAIN),
            "TRIASSET_ZIP_NAME": ("A member's name is not manifest.json or buffers/NAME.bin.", _EXPORT_AGAIN),
            "TRIASSET_ZIP_DUPLICATE_MEMBER": ("Two members have the same name.", _EXPORT_AGAIN),
            "TRIASSET_ZIP_COMPRESSED": (
                "A member is compressed.",
                "Store it: members are memory-mapped as they are.",
            ),
            "TRIASSET_ZIP_ENCRYPTED": ("A member is encrypted.", "Write it without a password."),
            "TRIASSET_ZIP_MISALIGNED": (
                "A member's data does not start on a 64-byte boundary.",
                "Pad the local header's extra field.",
            ),
            "TRIASSET_ZIP_HEADER_MISMATCH": ("Local and central header disagree.", _EXPORT_AGAIN),
            "TRIASSET_ZIP_FOREIGN_DATA": ("There are bytes that belong to no member.", _EXPORT_AGAIN),
            "TRIASSET_ZIP_ZIP64": ("The ZIP64 records are inconsistent.", _EXPORT_AGAIN),
            "TRIASSET_ZIP_CRC": ("A member's CRC-32 is wrong.", "Copy the file again."),
        },
    ),
    **_codes(
        CheckpointError,
        {
            # --- the kind of file
            "CHECKPOINT_EMPTY": ("The file holds no bytes.", _COPY_AGAIN),
            "CHECKPOINT_NOT_RECOGNISED": (
                "The file does not start like anything torch.save writes.",
                "Give a .pt or .ckpt file; a Git LFS pointer has to be fetched first.",
            ),
            "CHECKPOINT_BARE_PICKLE": ("The file is a pickle that torch.save did not write.", _SAVE_AGAIN),
            "CHECKPOINT_TAR": ("The file is in torch's tar format of before 2017.", _SAVE_AGAIN),
            "CHECKPOINT_SAFETENSORS": (
                "The file is in the safetensors format.",
                "Give the .pt or .ckpt file the method itself wrote.",
            ),
            "CHECKPOINT_TORCHSCRIPT": (
                "The file is a TorchScript program, not a saved state.",
                "Save model.state_dict() with torch.save.",
            ),
            "CHECKPOINT_VERSION": ("The archive's version is missing or not one we read.", _SAVE_AGAIN),
            "CHECKPOINT_BYTE_ORDER": (
                "The numbers are not little-endian.",
                "Load it and save it again on a little-endian machine.",
            ),
            "CHECKPOINT_LEGACY_HEADER": (
                "What a torch file of before 1.6 starts with is malformed.",
                _SAVE_AGAIN,
            ),
            "CHECKPOINT_LEGACY_STORAGES": (
                "The storages behind the pickle of a torch file of before 1.6 are not those it names.",
                _COPY_AGAIN,
            ),
            # --- the archive
            "CHECKPOINT_ZIP_TRUNCATED": ("The end of the archive is missing.", _COPY_AGAIN),
            "CHECKPOINT_ZIP_DIRECTORY": ("The archive's directory is not well formed.", _COPY_AGAIN),
            "CHECKPOINT_ZIP_TOO_MANY_MEMBERS": ("The archive has more members than we accept.", _SAVE_AGAIN),
            "CHECKPOINT_ZIP_NAME": ("A member has a name that torch.save does not give.", _SAVE_AGAIN),
            "CHECKPOINT_ZIP_DUPLICATE_MEMBER": ("Two members have the same name.", _HOSTILE),
            "CHECKPOINT_ZIP_COMPRESSED": (
                "A member is compressed.",
                "Pack it again without compression (zip -0), or save it again with torch.save.",
            ),
            "CHECKPOINT_ZIP_ENCRYPTED": ("A member is encrypted.", _SAVE_AGAIN),
            "CHECKPOINT_ZIP_HEADER_MISMATCH": ("The headers of a member contradict each other.", _HOSTILE),
            "CHECKPOINT_ZIP_FOREIGN_DATA": ("There are bytes that belong to no member.", _HOSTILE),
            "CHECKPOINT_ZIP_ZIP64": ("The ZIP64 records are inconsistent.", _HOSTILE),
            "CHECKPOINT_ZIP_CRC": ("data.pkl is not what the archive's checksum says.", _COPY_AGAIN),
            "CHECKPOINT_PICKLE_MISSING": (
                "The archive holds no data.pkl.",
                "Give a .pt or .ckpt file; other archives (.npz, .triasset) are not checkpoints.",
            ),
            "CHECKPOINT_PICKLE_AMBIGUOUS": ("The archive holds several data.pkl.", _HOSTILE),
            # --- the pickle
            "CHECKPOINT_PICKLE_TOO_LARGE": ("The pickle is larger than we accept.", _SAVE_AGAIN),
            "CHECKPOINT_PICKLE_TRUNCATED": ("The pickle ends inside an instruction.", _COPY_AGAIN),
            "CHECKPOINT_PICKLE_NO_STOP": ("The pickle ends without its last instruction.", _COPY_AGAIN),
            "CHECKPOINT_PICKLE_TRAILING": ("There are bytes behind the pickle's end.", _HOSTILE),
            "CHECKPOINT_PICKLE_PROTOCOL": ("The pickle is not of protocol 2, 3 or 4.", _SAVE_AGAIN),
            "CHECKPOINT_PICKLE_OPCODE": ("The pickle has an instruction we do not follow.", _HOSTILE),
            "CHECKPOINT_PICKLE_GLOBAL": (
                "The pickle names a function or class that no tensor needs.",
                "Nothing of it was run. Do not load the file with torch unless you trust its source; "
                "then save its tensors alone.",
            ),
            "CHECKPOINT_PICKLE_FRAME": ("A frame of the pickle has a wrong length.", _HOSTILE),
            "CHECKPOINT_PICKLE_STACK": ("An instruction takes what was never put on the stack.", _HOSTILE),
            "CHECKPOINT_PICKLE_MARK": ("Marks of the pickle are not in pairs.", _HOSTILE),
            "CHECKPOINT_PICKLE_MEMO": ("The pickle's memo is used in a way no writer uses it.", _HOSTILE),
            "CHECKPOINT_PICKLE_TOO_MANY_OPCODES": ("The pickle has too many instructions.", _SAVE_AGAIN),
            "CHECKPOINT_PICKLE_TOO_DEEP": ("Values nest too deeply.", _HOSTILE),
            "CHECKPOINT_PICKLE_CYCLE": ("A value contains itself.", _HOSTILE),
            "CHECKPOINT_PICKLE_EXPANSION": (
                "Shared values would be far too many if written out.",
                _HOSTILE,
            ),
            "CHECKPOINT_PICKLE_KEY": (
                "A dictionary's key is neither text nor a 64-bit integer.",
                _SAVE_AGAIN,
            ),
            "CHECKPOINT_PICKLE_DUPLICATE_KEY": ("A dictionary gets the same key twice.", _HOSTILE),
            "CHECKPOINT_PICKLE_ITEM": ("An item is added to what is no list or dictionary.", _HOSTILE),
            "CHECKPOINT_PICKLE_TEXT": ("Text is not valid UTF-8.", _HOSTILE),
            "CHECKPOINT_PICKLE_INTEGER": ("An integer is too large or has a negative size.", _HOSTILE),
            "CHECKPOINT_PICKLE_CALL": ("A call has a wrong target or wrong arguments.", _HOSTILE),
            "CHECKPOINT_PICKLE_BUILD": ("A state is set on what has none, or is malformed.", _HOSTILE),
            "CHECKPOINT_PICKLE_PERSISTENT_ID": ("The reference to a storage is malformed.", _HOSTILE),
            "CHECKPOINT_PICKLE_SCALAR": (
                "A NumPy scalar is malformed or of a type we do not read.",
                _SAVE_AGAIN,
            ),
            "CHECKPOINT_PICKLE_RESULT": ("The result holds something that is not data.", _SAVE_AGAIN),
            # --- storages and tensors
            "CHECKPOINT_STORAGE_MISSING": ("The bytes of a tensor are not in the archive.", _COPY_AGAIN),
            "CHECKPOINT_STORAGE_SIZE": ("A storage has not the size the pickle declares.", _COPY_AGAIN),
            "CHECKPOINT_STORAGE_CONFLICT": ("One storage is declared in two ways.", _HOSTILE),
            "CHECKPOINT_TENSOR_DTYPE": (
                "A tensor has a type we do not read, such as complex or quantised.",
                "Convert it with .float() and save again.",
            ),
            "CHECKPOINT_TENSOR_KIND": (
                "A tensor is sparse, nested, quantised, without data or of a newer kind.",
                "Save it as a dense tensor.",
            ),
            "CHECKPOINT_TENSOR_ARGUMENTS": ("What a tensor is made from is malformed.", _HOSTILE),
            "CHECKPOINT_TENSOR_SHAPE": (
                "A tensor's size is negative, too large or has too many axes.",
                _HOSTILE,
            ),
            "CHECKPOINT_TENSOR_STRIDE": ("A tensor's strides are negative or not one per axis.", _HOSTILE),
            "CHECKPOINT_TENSOR_RANGE": ("A tensor reaches beyond its storage.", _HOSTILE),
            "CHECKPOINT_TENSOR_EXPANDED": (
                "A tensor repeats elements until it has more than its storage.",
                "Save it after .contiguous().",
            ),
            "CHECKPOINT_TENSOR_BOOL": ("A boolean is neither 0 nor 1.", _COPY_AGAIN),
            # What the model's files hold, once they have been read:
            "CHECKPOINT_UNKNOWN": (
                "The file or folder holds no model of a method we know.",
                "docs/export.md lists what each method's output looks like.",
            ),
            "CHECKPOINT_METHOD": (
                "The model is of another method than --method says.",
                "Leave out --method, or give the one the message names.",
            ),
            "CHECKPOINT_FILE_MISSING": (
                "A file that the model needs is not there.",
                "Copy the whole output folder; the message names the file.",
            ),
            "CHECKPOINT_FILE_CONTENT": (
                "A file beside the model does not hold what it must.",
                _COPY_AGAIN,
            ),
            "CHECKPOINT_KEY_MISSING": ("The model lacks a tensor or value.", _OTHER_LAYOUT),
            "CHECKPOINT_KEY_TYPE": ("A tensor or number is something else.", _OTHER_LAYOUT),
            "CHECKPOINT_KEY_DTYPE": ("A tensor has numbers of another type.", _OTHER_LAYOUT),
            "CHECKPOINT_KEY_SHAPE": ("A tensor has another shape than the method's.", _OTHER_LAYOUT),
            "CHECKPOINT_VALUE_NONFINITE": (
                "A parameter is NaN or infinite: the training diverged.",
                "Export an earlier iteration.",
            ),
            "CHECKPOINT_VALUE_INDEX": ("A face uses a vertex that does not exist.", _OTHER_LAYOUT),
            "CHECKPOINT_VALUE_RANGE": ("A value is outside what the method allows.", _OTHER_LAYOUT),
            "CHECKPOINT_ROUNDED": (
                "A tensor was rounded to float32.",
                "Nothing, unless the model was meant to be in double precision.",
            ),
            "CHECKPOINT_CONFIG_MISSING": (
                "The training's configuration was not found, so defaults stand in for it.",
                "Give --config FILE, or the settings with --set.",
            ),
            "CHECKPOINT_CONFIG_FILE": (
                "A configuration cannot be read or parsed.",
                "Correct it, or give the settings with --set.",
            ),
            "CHECKPOINT_CONFIG_VALUE": (
                "A configuration has a value that its key cannot take, or that changes what numbers mean.",
                "Correct it, or give the setting with --set; train as the benchmark evaluates.",
            ),
        },
    ),
}
"""Every code there is. docs/errors.md is generated from this table (a test holds them equal)."""
