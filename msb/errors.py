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
from typing import Any, Literal, NamedTuple, Self

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
    ) -> None:
        if CODES[code].kind is not type(self):
            text = f"{code} is registered for {CODES[code].kind.__name__}, not {type(self).__name__}"
            raise TypeError(text)
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
        return CODES[self.code].kind(self.code, self.message, file=path, pointer=self.pointer)


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


def _codes(kind: type[MsbError], table: dict[str, tuple[str, str]]) -> dict[str, Code]:
    return {name: Code(kind, summary, remedy) for name, (summary, remedy) in table.items()}


_EXPORT_AGAIN = "Export the asset again from its checkpoint or mesh."
_FIX_MANIFEST = "Correct manifest.json (docs/triasset.md lists every key) or export the asset again."
_COPY_AGAIN = "Copy or download the file again."
_FIX_CAMERAS = "Correct the file; docs/cameras.md has the rules of its format."

CODES: dict[str, Code] = {
    **_codes(
        GateFailed,
        {
            "GATE_FAILED": (
                "A bar set by an option is not met: --fail-on, --profile, --at-least, --fail-slower.",
                "The message says what was measured: mend what it names, or relax the bar.",
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
            "VIEW_NO_DISPLAY": (
                "There is no display to open a window on, or VTK has nothing to draw with.",
                "Give --screenshot, --html or --figure; for those VTK needs EGL or OSMesa, or --html alone.",
            ),
            "OUTPUT_EXISTS": (
                "The output exists and --force was not given.",
                "Give --force (overwrite=True in Python) or another name.",
            ),
            "RESULTS_MIXED": (
                "Results that would stand beside each other differ in a metric's definition, setup or asset.",
                "Report them apart or run the older ones again; --allow-mixed takes them and says so.",
            ),
            "NAME_UNKNOWN": (
                "There is nothing of that name or number: camera, renderer, table, quantity, layer, element.",
                "The message lists what there is, or the nearest names.",
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
            "PACKAGE_LEFT_OUT": (
                "A package's method, renderer or metric is left out: it cannot be loaded, it fails, or its "
                "name is taken.",
                "Update or remove the package; everything else works as before.",
            ),
            "PACKAGE_PRINTS": (
                "A package with a method, renderer or metric prints when it is imported.",
                "Nothing is wrong: what it prints is kept out of the result. Tell its authors.",
            ),
            "RESULTS_BUSY": (
                "Another msb run is writing into the results folder.",
                "Wait for it or stop it; the message says where it runs.",
            ),
            "RUN_SCHEDULER": (
                "There is no Dask scheduler at that address, it is lost, or a worker sees no files.",
                "Start one with dask scheduler, and mount results, scenes and models under the same paths on "
                "every machine; docs/protocol.md has the commands.",
            ),
            "ENGINE_MISSING": (
                "The engine that is to draw is not installed.",
                "The message says what to install; so do docs/engines.md and msb devices.",
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
            "DEVICE_COMMAND": (
                "The device refused or failed a command, or allows smaller work-groups than a kernel needs.",
                "Try another device (msb devices lists them); if it stays, report what --debug shows.",
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
            "OUTPUT_FORMAT_LIMIT": (
                "The output's format cannot hold this mesh: too large, or a coordinate does not fit.",
                "Choose another format (PLY holds any mesh), or repair the vertices that msb-audit names.",
            ),
        },
    ),
    **_codes(
        Unsupported,
        {
            "UNSUPPORTED_METHOD": (
                "Models of this method cannot be exported, or the method has no exporter of its own.",
                "The message says why, and what to give instead.",
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
        },
    ),
    **_codes(
        InputError,
        {
            "FILE_NOT_FOUND": ("The path does not exist.", "Check the spelling."),
            "FILE_UNREADABLE": (
                "The path exists but cannot be read as a file or folder, or two files share its name.",
                "Check its permissions; pipes and devices are not read.",
            ),
            "FILE_NOT_RECOGNISED": (
                "Neither the name nor the content is of a kind we read.",
                "Give a .triasset, a mesh file (docs/meshes.md has the formats), or a folder of these.",
            ),
            "RECORD_INVALID": (
                "A result record is not one of ours, was changed by hand, or lies in another cell's place.",
                "The message names the key; docs/protocol.md has all of them. Run the cell again.",
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
                "Vertices or faces are not those of a triangle mesh, or too many for 32-bit numbers.",
                "Vertices are (V, 3) numbers, faces (F, 3) integers.",
            ),
            "MESH_INDEX_OUT_OF_RANGE": (
                "A face uses a vertex that does not exist.",
                "Indices run from 0 to V - 1; a negative index is never wrapped.",
            ),
            "MESH_NONFINITE": (
                "A coordinate is NaN or infinite where geometry is computed.",
                "Remove or correct the vertex that the message names; the audit counts such faces.",
            ),
            "WELD_DISTANCE": (
                "The weld distance is no positive finite length, or so large that the mesh would collapse.",
                "Give --weld exact or a length well below the typical edge, in the units of the mesh.",
            ),
        },
    ),
    **_codes(
        MeshFileError,
        {
            "MESH_FILE_INVALID": (
                "The file breaks the rules of its format.",
                "Export the mesh again from the program that wrote it.",
            ),
            "MESH_FILE_TRUNCATED": ("The file ends before all declared elements.", _COPY_AGAIN),
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
                "Export the mesh again, in parts if it is as large as it says.",
            ),
        },
    ),
    **_codes(
        MetricError,
        {
            "METRIC_IMAGE": (
                "An image cannot be compared: its file, shape, number type or values.",
                "Give 8-bit RGB PNG or JPEG, or float .npy or .exr as msb render writes; in Python bytes "
                "or floats in [0, 1], height x width x 3.",
            ),
            "METRIC_SIZES_DIFFER": (
                "The two images differ in size.",
                "Render at the size of the ground truth; nothing is resized here.",
            ),
            "METRIC_IMAGE_ALPHA": (
                "An image is partly transparent and no background was given.",
                "Give --background; the same for both folders.",
            ),
            "METRIC_IMAGE_NAMES": (
                "The two folders do not hold the same images.",
                "The message names them; --subset lets GT hold more than PRED.",
            ),
            "METRIC_WEIGHTS": (
                "The weights of torchvision's VGG16, or the layers of lpips, are not those needed.",
                "docs/metrics.md says which file it is and where it comes from; install lpips 0.1.4.",
            ),
            "METRIC_VGG_UNKNOWN": (
                "The VGG16 weights are not the published ones: LPIPS compares with nothing published.",
                "Use vgg16-397923af.pth; docs/metrics.md says where it comes from.",
            ),
            "METRIC_MESH": (
                "The mesh or points cannot be evaluated: shape, index, coordinate or scale.",
                "Vertices are (V, 3) finite numbers, faces (F, 3) indices below V; DTU in millimetres.",
            ),
            "METRIC_DTU": (
                "A file, matrix or mask of the DTU evaluation data is not what it must be.",
                "Take the file from the official DTU MVS 2014 archives; docs/metrics.md lists them.",
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
            "CAMERA_INVALID": (
                "A camera is not one: its size, focal length, principal point, pose, name or split.",
                "Correct the camera; docs/cameras.md has the conventions.",
            ),
            "CAMERA_PATH": (
                "A camera, or a path of cameras, cannot be made from what was given.",
                "The message says what is needed.",
            ),
            "CAMERA_SOURCE": (
                "Neither a file nor a folder of a kind that cameras are read from.",
                "Give a COLMAP folder, a transforms_*.json, a cameras.json or a views.json.",
            ),
            "CAMERA_NONE": ("There is no camera in it.", "Give a file with at least one."),
            "CAMERA_DISTORTED": (
                "The camera is not a pinhole camera: its lens distorts, or its model is not known.",
                "Undistort the images first, for instance with COLMAP's image_undistorter.",
            ),
            "CAMERA_IMAGE": (
                "The size of an image is needed, and its file is absent or no PNG or JPEG.",
                "Put the images where the file says, or give the size: w and h.",
            ),
            "CAMERA_FILE": ("A file of cameras breaks the rules of its format.", _FIX_CAMERAS),
            "COLMAP_INVALID": (
                "A file of a COLMAP model is cut short or breaks its format.",
                "Copy it again, or write the model again with COLMAP's model_converter.",
            ),
            "COLMAP_FILE_MISSING": (
                "The folder holds part of a COLMAP model only.",
                "cameras and images belong together, both .bin or both .txt; points3D has the points.",
            ),
            "SCENE_LAYOUT": (
                "The folder is not laid out as a scene of a dataset, or a part of the layout is absent.",
                "docs/datasets.md shows the layouts: sparse/0, transforms_train.json or cameras.npz.",
            ),
            "SCENE_UNKNOWN": (
                "The dataset has no such scene, or the loader no rule for the dataset.",
                "Give another dataset, or say which image folder is meant.",
            ),
            "SCENE_ARGUMENT": ("An option of a scene is out of range.", "The message says what it takes."),
            "SCENE_IMAGE_MISSING": (
                "Photographs, or the folder of them that the protocol takes, are not there.",
                "Download the scene again; results on other sizes cannot be compared.",
            ),
            "SCENE_IMAGE_RESIZED": (
                "The photographs are resized here: the shipped folder of that size is absent.",
                "Download it; results on it and on resized photographs differ by up to 0.5 dB.",
            ),
            "SCENE_IMAGE": (
                "Photographs, masks and cameras do not go together: size, shape or alpha channel.",
                "Download the scene again; docs/datasets.md says what each dataset needs.",
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
            "TRIASSET_MANIFEST_MISSING": ("There is no manifest.json.", _EXPORT_AGAIN),
            "TRIASSET_MANIFEST": ("manifest.json is not the strict JSON of a .triasset.", _FIX_MANIFEST),
            "TRIASSET_VERSION_UNSUPPORTED": (
                "The major version is not one this release reads.",
                "Use a release of meshsplatbench that reads this version.",
            ),
            "TRIASSET_VERSION_NEWER": (
                "The minor version is newer: unknown keys are ignored.",
                "Upgrade meshsplatbench to see them.",
            ),
            "TRIASSET_FIELD": ("A key of the manifest is absent or has a value it cannot.", _FIX_MANIFEST),
            "TRIASSET_FIELD_UNKNOWN": ("The format has no such key; it is ignored.", _FIX_MANIFEST),
            "TRIASSET_METHOD_NOT_INSTALLED": (
                "The asset's method is not installed: the asset is audited, converted and drawn on the "
                "standard tier; its settings and its kernel are not checked.",
                "Install the package that brings the method, if its own look is wanted, or mend the name.",
            ),
            "TRIASSET_EMPTY": ("The asset has no vertices or no faces.", _EXPORT_AGAIN),
            "TRIASSET_BOUNDS": ("The bounds or the sphere are not those of the positions.", _EXPORT_AGAIN),
            "TRIASSET_PATH": (
                "A file of the asset could stand for another: a link, a device, an unsafe or equal name.",
                'An asset is complete by itself: "buffers/NAME.bin" with letters, digits, "_", "-" and "."; '
                "copy the data there.",
            ),
            "TRIASSET_FILE_UNREADABLE": ("A file of the asset cannot be read.", "Check its permissions."),
            "TRIASSET_FILE_UNDECLARED": (
                "The asset holds a file that no buffer declares.",
                "Remove it, or declare it.",
            ),
            "TRIASSET_BUFFER": ("What the manifest declares of a buffer cannot be.", _FIX_MANIFEST),
            "TRIASSET_DAMAGED": (
                "The bytes are not those the manifest was written for: missing, cut short or changed.",
                "Copy the asset again from its source, or export it again.",
            ),
            "TRIASSET_FORM": (
                "The ZIP is not packed as the format says: stored, aligned to 64 bytes, its members alone.",
                "Save the asset with msb convert or msb.save; docs/triasset.md has the rules.",
            ),
            "TRIASSET_HOSTILE": (
                "The ZIP contradicts itself or hides bytes; no program writes this by accident.",
                "Find out where the file comes from before it is used, and export the asset again.",
            ),
            "TRIASSET_VALUE_NONFINITE": ("A buffer holds NaN or infinity.", _EXPORT_AGAIN),
            "TRIASSET_VALUE_RANGE": ("A value is outside its buffer's range.", _EXPORT_AGAIN),
            "TRIASSET_INDEX_OUT_OF_RANGE": ("A face uses a vertex that does not exist.", _EXPORT_AGAIN),
            "TRIASSET_FACE_REPEATED_INDEX": ("A face uses a vertex twice; it draws nothing.", "None needed."),
            "TRIASSET_FACE_DUPLICATE": ("Two faces use the same three vertices.", "None needed."),
            "TRIASSET_FACE_ZERO_AREA": ("A face has no area; it draws nothing.", "None needed."),
            "TRIASSET_VERTEX_UNREFERENCED": ("No face uses the vertex.", "None needed."),
        },
    ),
    **_codes(
        CheckpointError,
        {
            "CHECKPOINT_NOT_RECOGNISED": (
                "The file is nothing that torch.save writes of a model.",
                "Give the .pt or .ckpt file the method wrote; a Git LFS pointer has to be fetched first.",
            ),
            "CHECKPOINT_DAMAGED": ("The file is cut short or changed.", _COPY_AGAIN),
            "CHECKPOINT_HOSTILE": (
                "The file does what torch.save never does, such as naming a function that no tensor needs.",
                "Nothing of it was run. Do not load it with torch unless you trust where it comes from; then "
                "save its tensors alone.",
            ),
            "CHECKPOINT_FORM": (
                "The file, or a tensor in it, is of a kind that is not read.",
                "Load it where it was trained and save it again with torch.save, as plain dense tensors.",
            ),
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
            "CHECKPOINT_LAYOUT": (
                "A tensor or value of the model is absent or not what the method's code writes.",
                "The file is damaged or of another version of the method's code than docs/export.md names.",
            ),
            "CHECKPOINT_NONFINITE": (
                "A parameter is NaN or infinite: the training diverged.",
                "Export an earlier iteration.",
            ),
            "CHECKPOINT_ROUNDED": (
                "A tensor was rounded to float32.",
                "Nothing, unless the model was meant to be in double precision.",
            ),
            "CHECKPOINT_CONFIG_MISSING": (
                "The training's configuration was not found, so defaults stand in for it.",
                "Give --config FILE, or the settings with --set.",
            ),
            "CHECKPOINT_CONFIG": (
                "A configuration cannot be read, or has a value that its key cannot take or that changes "
                "what numbers mean.",
                "Correct it, or give the setting with --set; train as the benchmark evaluates.",
            ),
        },
    ),
}
"""Every code there is. The page docs/errors.md has this table on the site."""
