"""The declaration of a mesh format, and a table of all formats, including formats of other packages."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, get_args

from msb.base.packages import Lazy, PackageError, contain_errors, describe_entry, find_installed, load
from msb.errors import MeshError, UsageError, shorten

if TYPE_CHECKING:
    from msb.meshes.mesh import Mesh
    from msb.meshes.source import Source


Color = Literal["linear", "srgb"]
Picture = Literal["png", "jpeg", "webp"]


@dataclass(frozen=True)
class Web:
    """The precision of a compressed GLB for the web.

    Attributes
    ----------
    quarters : int
        Position precision in quarters of a bit. The grid has about 2 ** (quarters / 4) steps along the
        longest side of the bounding box. 88 is about the precision of float32.
    levels : float, optional
        Largest colour error in levels of 8-bit sRGB. Colours are stored as 16-bit linear light, rounded to as
        few significant bits as this error allows. The value None stores colours as 8-bit linear light, with
        errors of up to 6 levels in dark colours.
    by_distance : bool
        For triangle soups, use a finer grid for faces near the centre of the scene, and a coarser grid far
        away.
    """

    quarters: int = 64
    levels: float | None = 1.0
    by_distance: bool = False


@dataclass(frozen=True)
class Style:
    """Options for writing a mesh file.

    Attributes
    ----------
    color : {"linear", "srgb"}, optional
        The colour space of vertex colours. With None, the format's default is used.
    texture : {"png", "jpeg", "webp"}
        The image format of textures.
    web : Web, optional
        For GLB, the precision of a compressed file, whose rows are reordered. The value None gives an
        uncompressed file, which every program can read.
    stem : str, optional
        The file name, without suffix, of additional files such as materials and images. With None, additional
        files are not written.
    extras : mapping, optional
        For GLB: JSON data for the file's `asset.extras`.
    collision : tuple of Mesh
        For USD: collision shapes.
    is_convex : bool
        Whether each collision shape is convex.
    is_lit : bool
        For GLB, OBJ and USD: whether programs light the materials. By default, programs show colours as
        stored.
    """

    color: Color | None = None
    texture: Picture = "png"
    web: Web | None = None
    stem: str | None = None
    extras: Mapping[str, Any] | None = None
    collision: tuple[Mesh, ...] = ()
    is_convex: bool = False
    is_lit: bool = False


Kept = Literal["vertex_colors", "face_colors", "vertex_uvs", "normals", "textures", "collision"]


@dataclass(frozen=True)
class Format:
    """One mesh format.

    A built-in format is declared in a module, and registered by one line in `msb.meshes.files`. Another
    package registers its format with an entry point of the group `msb.meshes` (docs/extending.md).

    Attributes
    ----------
    title : str
        The name in messages, such as "PLY".
    suffixes : tuple of str
        The suffixes in lower case, the usual suffix first, such as (".ply",).
    read : callable
        A function from `Source` to `Mesh`. For invalid bytes the function raises only `MeshFileError`.
    write : callable, optional
        A function that writes a mesh with valid coordinates and indices to a binary stream. The value is None
        for a read-only format.
    begins : compiled pattern of bytes, optional
        The signature at the start of every file of this format. Files of other formats must not begin with
        this signature. The signature identifies files with a wrong suffix.
    companions : callable, optional
        A function that returns the contents of the additional files of a mesh (materials, images) by name.
        The file names begin with the `stem` of the style.
    keeps : tuple of {"vertex_colors", "face_colors", "vertex_uvs", "normals", "textures", "collision"}
        The optional parts of a mesh that the format can store.
    list_stored, list_lost : callable, optional
        Functions of a textured mesh. The function `list_stored` names the colours and textures that a file
        stores. The function `list_lost` names the parts of a mesh that a file does not store. Both functions
        are only needed if `keeps` does not determine the stored data.
    is_soup : bool
        True if the format stores three vertices per face, so that faces never share vertices.
    is_single : bool
        True if the format always stores coordinates as float32.
    has_origin : bool
        For `is_single`: True if the format stores coordinates relative to a point in float64, such as the
        translation of a node (`msb.meshes.writing.as_local`).
    is_linear : bool
        True if the format defines vertex colours as linear light.
    up : str, optional
        The axis that the format defines as up, such as "+y".
    """

    title: str
    suffixes: tuple[str, ...]
    read: Callable[[Source], Mesh]
    write: Callable[[Mesh, BinaryIO, Style], None] | None = None
    begins: re.Pattern[bytes] | None = None
    companions: Callable[[Mesh, Style], dict[str, bytes]] | None = None
    keeps: tuple[Kept, ...] = ()
    list_stored: Callable[[Mesh], list[str]] | None = None
    list_lost: Callable[[Mesh], list[str]] | None = None
    is_soup: bool = False
    is_single: bool = False
    has_origin: bool = False
    is_linear: bool = False
    up: str | None = None


# Suffixes that no package may register.
_RESERVED = (".triasset",)
_AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
_KEEPS = get_args(Kept)
# Maps suffixes in lower case to built-in formats. `msb.meshes.files` fills it.
OURS: dict[str, Format] = {}


@cache
def _theirs() -> dict[str, Format]:
    """Return the formats of other packages (entry points `msb.meshes`) by suffix.

    Built-in suffixes cannot be replaced.
    """
    formats: dict[str, Format] = {}

    def accept(name: str, entry: str) -> None:
        form = _load_package_format(name, entry)
        for suffix in form.suffixes:
            if suffix in OURS or suffix in _RESERVED:
                raise PackageError(f"the suffix {suffix} is built into msb")
            if suffix in formats:
                raise PackageError(f"the suffix {suffix} is already registered by {formats[suffix].title}")
        formats.update(dict.fromkeys(form.suffixes, form))

    ours = {suffix.removeprefix("."): "msb.meshes" for suffix in OURS}
    find_installed("mesh", ours, accept)
    return formats


# All formats by suffix, in lower case: built-in formats, then the formats of other packages.
FORMATS: Mapping[str, Format] = Lazy(lambda: {**OURS, **_theirs()} if OURS else {})


def list_written_suffixes() -> list[str]:
    """Return the suffixes of the formats that can be written."""
    return [suffix for suffix, form in FORMATS.items() if form.write is not None]


def _load_package_format(name: str, entry: str) -> Format:
    form = load(entry)
    if not isinstance(form, Format):
        raise PackageError(
            f"the entry point must be a msb.meshes.formats.Format, not of type {type(form).__name__}"
        )
    if not isinstance(form.title, str) or not form.title.isprintable() or not form.title:
        raise PackageError("its title must be a text with a single line")
    suffixes: Any = form.suffixes
    if not isinstance(suffixes, tuple) or not suffixes:
        raise PackageError('its suffixes must be a tuple such as (".tri",)')
    for suffix in suffixes:
        if not isinstance(suffix, str) or not re.fullmatch(r"\.[a-z0-9_-]{1,20}", suffix):
            raise PackageError(f'the suffix {shorten(repr(suffix), 40)} must be lower case, such as ".tri"')
    if not isinstance(form.keeps, tuple) or not set(form.keeps) <= set(_KEEPS):
        raise PackageError(f"its `keeps` must be a tuple of values from {', '.join(_KEEPS)}")
    if form.up is not None and form.up not in _AXES:
        raise PackageError(f"its `up` must be None or one of {', '.join(_AXES)}")
    begins: Any = form.begins
    if begins is not None and not (isinstance(begins, re.Pattern) and isinstance(begins.pattern, bytes)):
        raise PackageError("its `begins` must be a compiled pattern of bytes")
    if begins is not None and begins.match(b""):
        raise PackageError("its pattern `begins` matches every file")
    functions: tuple[Any, ...] = (form.read, form.write, form.companions)
    if not callable(form.read) or not all(function is None or callable(function) for function in functions):
        raise PackageError("its `read`, `write` and `companions` must be functions")
    whose = describe_entry("mesh format", name, entry)
    read, write, companions = functions
    return replace(
        form,
        read=_PackageReader(whose, read),
        write=write and _PackageFunction(whose, write),
        companions=companions and _PackageFunction(whose, companions),
    )


@dataclass(frozen=True)
class _PackageFunction:
    """Wraps a function of a mesh format from another package.

    Error messages of the function contain the name of the package.
    """

    whose: str
    function: Callable[..., Any]

    def __call__(self, *arguments: Any) -> Any:
        try:
            with contain_errors():
                return self.function(*arguments)
        except PackageError as error:
            if isinstance(error.__cause__, OSError | MemoryError):
                raise error.__cause__ from None  # for example, the disk is full
            raise UsageError("PACKAGE_LEFT_OUT", f"{self.whose}: {error}") from error.__cause__


@dataclass(frozen=True)
class _PackageReader:
    """Wraps the function `read` of a mesh format from another package.

    If the function raises any error, the file counts as invalid.
    """

    whose: str
    function: Callable[[Source], Mesh]

    def __call__(self, source: Source) -> Mesh:
        from msb.meshes.mesh import Mesh

        try:
            with contain_errors():
                try:
                    mesh = self.function(source)
                except MeshError as error:  # the arrays of the function are not a valid mesh
                    raise PackageError(error.message) from error
                if not isinstance(mesh, Mesh):
                    raise PackageError(f"`read` must return a msb.meshes.Mesh, not a {type(mesh).__name__}")
        except PackageError as error:
            if isinstance(error.__cause__, MemoryError):
                raise error.__cause__ from None
            text = f"the file cannot be read by {self.whose}: {error}"
            raise source.error("MESH_FILE_INVALID", text) from error.__cause__
        return mesh
