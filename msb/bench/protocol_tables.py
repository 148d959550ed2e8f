"""The tables and keys of a protocol file."""

import re
from functools import cache
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import Field, create_model

from msb.bench.records import CONDITIONS, Condition
from msb.bench.timing import Timing
from msb.bench.validation import Record
from msb.registry import Order, Sampling

# Method name that requests detection of the method from the model's files.
AUTO = "auto"
# Value of `non_engine` that requests images of our NumPy renderer in place of official renderings.
REFERENCE = "reference"
PLACES = ("dataset", "scene", "method")
# A placeholder in a path, or a doubled brace, which represents a single brace.
PLACE = re.compile(r"\{\{|\}\}|\{(.*?)\}")
# Pattern of valid names for folders in the results.
_NAME = r"^[^/\\\x00-\x1f.][^/\\\x00-\x1f]*$"

FolderName = Annotated[str, Field(pattern=_NAME, max_length=100)]
# A path relative to the protocol file with the placeholders {dataset}, {scene} and {method}.
Template = Annotated[str, Field(min_length=1)]
Unit = Annotated[float, Field(ge=0, le=1)]
Color = tuple[Unit, Unit, Unit]
Setting = bool | int | float | str


class SceneOptions(Record):
    """Options of a scene in a dataset or a method. Options of the method take precedence."""

    # Folder of the photographs below the scene, such as "images_4". Default: the folder of the dataset.
    image_folder: Annotated[str, Field(min_length=1)] | None = None
    # Downsampling factor or width in pixels, as the option ``-r`` of code derived from 3DGS.
    resolution: int | None = None
    background: Color | None = None
    # The camera convention during training. Default: "full_K" for DiffSoup and meshes, "gs_fov" for all other
    # methods.
    camera_convention: Literal["gs_fov", "full_K"] | None = None


class DatasetTable(SceneOptions):
    """``[[datasets]]``: the scenes of one dataset in one folder."""

    # Dataset name: "mipnerf360", "tanksandtemples", "nerf_synthetic", "dtu", or any name for another capture.
    name: FolderName
    # The folder that contains one folder per scene.
    path: Annotated[str, Field(min_length=1)]
    # Default: all scenes in the folder.
    scenes: tuple[FolderName, ...] = ()


class MethodTable(SceneOptions):
    """``[[methods]]``: the models of one method, and the files that belong to the models."""

    # A name listed by `msb methods`, or "auto" to detect the method from the model.
    name: str = AUTO
    # The label distinguishes models of one method, and names the columns and folders of the model.
    label: FolderName | None = None
    # The checkpoint, .triasset or mesh of each scene. If no model is given, only official renderings are
    # evaluated.
    model: Template | None = None
    # The datasets on which the method is evaluated. Default: all.
    datasets: tuple[FolderName, ...] = ()
    # Values that replace settings, like the option ``--set``.
    settings: dict[str, Setting] = Field(default_factory=dict)
    # Default: all conditions of the protocol.
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] | None = None
    # The folder of official renderings, or "reference". Without a folder or "reference", the condition
    # non_engine is left out.
    non_engine: Template | None = None
    # A timing of the method's official renderer (schema msb.renderer_timing/1).
    non_engine_timing: Template | None = None
    # A record of `msb track`.
    training: Template | None = None
    # If the training does not record its split, the user sets this key to confirm that no test view was used.
    held_out: bool = False
    # The mesh for the Chamfer distance. Default: the triangles of the asset.
    mesh: Template | None = None


class VariantTable(Record):
    """``[[variants]]``: an additional condition of the dedicated tier, rendered with other options."""

    # The name of the variant's condition. No other condition, engine or variant may have this name.
    label: FolderName
    # Drawing order, like the option ``--order`` of `msb render`. Default: the order of the official renderer.
    order: Order | None = None
    sampling: Sampling | None = None
    # A renderer of the dedicated tier, by its name in `msb devices`. Default: ours.
    renderer: Annotated[str, Field(min_length=1)] | None = None
    # Values that replace settings, like ``--set``, in addition to the method's settings.
    settings: dict[str, Setting] = Field(default_factory=dict)

    @property
    def options(self) -> dict[str, str]:
        """The order and the sampling of this variant, as options of a renderer."""
        given = {"order": self.order, "sampling": self.sampling}
        return {name: value for name, value in given.items() if value is not None}


class BakeTable(Record):
    """``[[bakes]]``: an additional condition, the result of `msb bake` on the standard tier.

    The table also accepts the options of `msb bake` with the names in `BAKE_KEYS`. Bakes are supervised by
    training views only.
    """

    # The name of the bake's condition. No other condition, engine, variant or bake may have this name.
    label: FolderName
    # Datasets whose models are baked. Default: all.
    datasets: tuple[FolderName, ...] = ()

    @property
    def options(self) -> dict[str, Any]:
        """The options for `msb.bake` without None values."""
        return self.model_dump(exclude={"label", "datasets"}, exclude_none=True)


# The options of a bake in a protocol. The default supervision is the native rendering of the method, or
# photographs for a mesh without a method's renderer.
BAKE_KEYS = ("geometry", "color", "supervision", "faces", "texture", "effort", "seconds", "seed")


class MetricsTable(Record):
    """``[metrics]``: `vgg_weights` is the file of torchvision's VGG16.

    "auto" looks for the file in the cache of torch. Without the file, LPIPS is not measured.
    """

    vgg_weights: str | None = None


class TimingTable(Record):
    """``[timing]``: the minimum number of frames and of seconds.

    If the number of frames is 0, timings are left out.
    """

    frames: Annotated[int, Field(ge=0)] = Timing.frames
    seconds: Annotated[float, Field(ge=0)] = Timing.seconds


class ChamferTable(Record):
    """``[chamfer]``: the folder of DTU's official evaluation data, and the seed for sampling points."""

    data: Annotated[str, Field(min_length=1)]
    seed: Annotated[int, Field(ge=0)] = 0


class VideosTable(Record):
    """``[videos]``: videos that show the conditions side by side along a camera path.

    The `path` "flight" is a smooth camera path through the test cameras. The `path` "test" shows the test
    views, together with the photographs and the official renderings.
    """

    path: Literal["flight", "test"] = "flight"
    frames: Annotated[int, Field(ge=2, le=100_000)] = 120
    fps: Annotated[int, Field(ge=1, le=240)] = 24


class WalkTable(Record):
    """``[walk]``: flicker and holes on a camera path away from the captured views."""

    # Names of conditions, engines, variants and bakes. Default: all conditions that our renderers or an
    # engine render.
    conditions: tuple[FolderName, ...] = ()

    # The camera path needs 24 frames from one stop to the next, so a loop with ten stops has 240 frames.
    frames: Annotated[int, Field(ge=3, le=100_000)] = 240
    # Distance from each stop of the camera path to the cameras, relative to the radius of the capture.
    reach: Annotated[float, Field(ge=0, le=10)] = 0.25
    # Longer side of the frames in pixels.
    size: Annotated[int, Field(ge=16, le=16_384)] = 640


class TrialTable(Record):
    """``[trial]``: tasks on the exported mesh, and the limits of each library."""

    # Names of the trial tasks, as in the option ``--task`` of `msb trial`. Default: all.
    tasks: tuple[str, ...] = ()
    # Whether to compare repairs of the mesh, as `msb repair --compare` does. If `tasks` is empty,
    # the default tasks of the comparison are used.
    compare: bool = False
    seconds: Annotated[float, Field(gt=0)] = 60.0
    # Memory limit in GiB.
    memory: Annotated[float, Field(gt=0)] = 4.0


class Protocol(Record):
    """A protocol file. docs/protocol.md shows an example with comments."""

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
def make_protocol_model(*, bakes: bool) -> type[Protocol]:
    """Return the data model of a protocol file.

    If `bakes` is true, the tables ``[[bakes]]`` accept the options of `msb.bake`. If a protocol has no bakes,
    `msb.bake` is not imported.
    """
    if not bakes:
        return Protocol
    from msb.bake.options import BakeOptions

    hints, defaults = get_type_hints(BakeOptions, include_extras=True), BakeOptions()
    keys: dict[str, Any] = {name: (hints[name], getattr(defaults, name)) for name in BAKE_KEYS}
    keys["supervision"] = (hints["supervision"] | None, None)
    table = create_model("BakeTable", __base__=BakeTable, **keys)
    more: dict[str, Any] = {"bakes": (tuple[table, ...], ())}  # type: ignore[valid-type]
    return create_model("Protocol", __base__=Protocol, **more)
