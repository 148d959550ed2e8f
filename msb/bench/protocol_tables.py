"""What a protocol file may hold, table by table."""

import re
from functools import cache
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import Field, create_model

from msb.bench.checked import Record
from msb.bench.records import CONDITIONS, Condition
from msb.bench.timing import Timing
from msb.registry import Order, Sampling

AUTO = "auto"
# The word that stands for our NumPy renderer in the place of a folder of official renderings.
REFERENCE = "reference"
PLACES = ("dataset", "scene", "method")
# A placeholder in a path; doubled braces stand for single ones.
PLACE = re.compile(r"\{\{|\}\}|\{(.*?)\}")
# A name that becomes the name of a folder below the results.
_NAME = r"^[^/\\\x00-\x1f.][^/\\\x00-\x1f]*$"

FolderName = Annotated[str, Field(pattern=_NAME, max_length=100)]
# A path relative to the protocol file, in which {dataset}, {scene} and {method} are placeholders.
Template = Annotated[str, Field(min_length=1)]
Unit = Annotated[float, Field(ge=0, le=1)]
Color = tuple[Unit, Unit, Unit]
Setting = bool | int | float | str


class SceneOptions(Record):
    """Options of a scene, set by its dataset; where a method sets one too, the method counts."""

    # The folder below the scene, such as "images_4"; the dataset's folder if not given.
    image_folder: Annotated[str, Field(min_length=1)] | None = None
    # With the meaning of ``-r`` in the 3DGS family.
    resolution: int | None = None
    background: Color | None = None
    # That of the method's training; by default "full_K" for DiffSoup, "gs_fov" for all others.
    camera_convention: Literal["gs_fov", "full_K"] | None = None


class DatasetTable(SceneOptions):
    """``[[datasets]]``: scenes of one dataset in one folder."""

    # "mipnerf360", "tanksandtemples", "nerf_synthetic", "dtu", or any other for a capture of your own.
    name: FolderName
    # The folder that holds the scenes' folders.
    path: Annotated[str, Field(min_length=1)]
    # All scenes in the folder, if not given.
    scenes: tuple[FolderName, ...] = ()


class MethodTable(SceneOptions):
    """``[[methods]]``: where one method's models are, and what belongs to them."""

    # A name that `msb methods` lists, or "auto", which takes the method found from the model.
    name: str = AUTO
    # Names the model's columns and folders, and tells it from others of its method; no method's name.
    label: FolderName | None = None
    # The checkpoint, .triasset or mesh of each scene. Without it there are official renderings only.
    model: Template | None = None
    # Those that the method is evaluated on; all, if not given.
    datasets: tuple[FolderName, ...] = ()
    # Values that replace settings, as ``--set`` takes them.
    settings: dict[str, Setting] = Field(default_factory=dict)
    # Those of the protocol, if not given.
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] | None = None
    # The folder of official renderings, or "reference". Without it there is no such cell.
    non_engine: Template | None = None
    # The file that says how fast the method's own renderer is (`msb.renderer_timing/1`).
    non_engine_timing: Template | None = None
    # The file that `msb track` wrote.
    training: Template | None = None
    # The mesh whose Chamfer distance is measured; the asset's own triangles if not given.
    mesh: Template | None = None


class VariantTable(Record):
    """``[[variants]]``: a condition of its own, drawn on the dedicated tier, but not as officially."""

    # Names the condition. It is no condition's, no engine's and no other variant's name.
    label: FolderName
    # As ``--order`` of `msb render` takes it; official if not given.
    order: Order | None = None
    sampling: Sampling | None = None
    # A renderer that draws the dedicated tier, by its name in `msb devices`; ours if not given.
    renderer: Annotated[str, Field(min_length=1)] | None = None
    # Overrides, as ``--set`` takes them, on top of the method's.
    settings: dict[str, Setting] = Field(default_factory=dict)

    @property
    def options(self) -> dict[str, str]:
        """What of `order` and `sampling` is given, as a renderer takes it."""
        given = {"order": self.order, "sampling": self.sampling}
        return {name: value for name, value in given.items() if value is not None}


class BakeTable(Record):
    """``[[bakes]]``: a condition of its own: the standard tier draws what `msb bake` makes of a model.

    The other keys are `BAKE_KEYS`, options of `msb bake` (`protocol_model`). Only training views supervise.
    """

    # Names the condition. It is no condition's, no engine's, no variant's and no other bake's name.
    label: FolderName
    # Those whose models are baked; all, if not given.
    datasets: tuple[FolderName, ...] = ()

    @property
    def options(self) -> dict[str, Any]:
        """The options for `msb.bake`, except those that are None."""
        return self.model_dump(exclude={"label", "datasets"}, exclude_none=True)


# The options of a bake that a protocol may set. Without `teacher`, a method with a native rendering
# supervises by it, and a plain mesh by photographs.
BAKE_KEYS = ("geometry", "color", "teacher", "faces", "texture", "seconds", "seed")


class MetricsTable(Record):
    """``[metrics]``: `vgg_weights` is the file of torchvision's VGG16, without which LPIPS is "--"."""

    vgg_weights: str | None = None


class TimingTable(Record):
    """``[timing]``: the clock runs for at least `frames` and `seconds`; 0 frames mean no timing."""

    frames: Annotated[int, Field(ge=0)] = Timing.frames
    seconds: Annotated[float, Field(ge=0)] = Timing.seconds


class ChamferTable(Record):
    """``[chamfer]``, for scenes of DTU: the official evaluation data, and the seed of the sampling."""

    data: Annotated[str, Field(min_length=1)]
    seed: Annotated[int, Field(ge=0)] = 0


class VideosTable(Record):
    """``[videos]``: films that show conditions side by side along a path.

    The `path` "flight" goes smoothly through the test cameras; "test" shows the test views themselves, and
    beside them the photographs and the official renderings.
    """

    path: Literal["flight", "test"] = "flight"
    frames: Annotated[int, Field(ge=2, le=100_000)] = 120
    fps: Annotated[int, Field(ge=1, le=240)] = 24


class WalkTable(Record):
    """``[walk]``: a flight off the path of the capture, on which flicker and holes are measured.

    `size` is the longer side of the frames in pixels.
    """

    # Names of conditions, engines, variants and bakes; all that we or an engine draw, if not given.
    conditions: tuple[FolderName, ...] = ()

    # 24 of them lead from one stop to the next; 240 go round a capture of ten test views or more.
    frames: Annotated[int, Field(ge=3, le=100_000)] = 240
    # How far the stops lie from the cameras, as a share of the capture's radius.
    reach: Annotated[float, Field(ge=0, le=10)] = 0.25
    size: Annotated[int, Field(ge=16, le=16_384)] = 640


class TrialTable(Record):
    """``[trial]``: tasks that are tried on the exported mesh, and the limits of each library."""

    # Names of tasks as `msb trial --task` takes them; all, if not given.
    tasks: tuple[str, ...] = ()
    # Whether ways to repair the mesh are compared, as `msb repair --compare` does, and tried by the `tasks`
    # given, else by those of that command.
    compare: bool = False
    seconds: Annotated[float, Field(gt=0)] = 60.0
    # GiB.
    memory: Annotated[float, Field(gt=0)] = 4.0


class Protocol(Record):
    """The whole file. docs/protocol.md has it with comments."""

    results: Annotated[str, Field(min_length=1)] = "results"
    device: str | None = None
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] = CONDITIONS
    engines: tuple[FolderName, ...] = ()
    datasets: Annotated[tuple[DatasetTable, ...], Field(min_length=1)]
    methods: Annotated[tuple[MethodTable, ...], Field(min_length=1)]
    variants: tuple[VariantTable, ...] = ()
    bakes: tuple[BakeTable, ...] = ()
    metrics: MetricsTable = MetricsTable()
    timing: TimingTable = TimingTable()
    chamfer: ChamferTable | None = None
    videos: VideosTable | None = None
    walk: WalkTable | None = None
    trial: TrialTable | None = None


@cache
def protocol_model(*, bakes: bool) -> type[Protocol]:
    """Return the model of a protocol file; with `bakes` the tables ``[[bakes]]`` have the options of a bake.

    These are declared by `msb.bake` alone, which only a protocol with bakes needs.
    """
    if not bakes:
        return Protocol
    from msb.bake.options import BakeOptions

    hints, defaults = get_type_hints(BakeOptions, include_extras=True), BakeOptions()
    keys: dict[str, Any] = {name: (hints[name], getattr(defaults, name)) for name in BAKE_KEYS}
    keys["teacher"] = (hints["teacher"] | None, None)
    table = create_model("BakeTable", __base__=BakeTable, **keys)
    more: dict[str, Any] = {"bakes": (tuple[table, ...], ())}  # type: ignore[valid-type]
    return create_model("Protocol", __base__=Protocol, **more)
