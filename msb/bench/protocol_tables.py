"""What a protocol file may hold, table by table."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from msb.bench.records import CONDITIONS, Condition
from msb.bench.timing import Timing
from msb.registry import Order, Sampling

AUTO = "auto"
REFERENCE = "reference"
"""The word that stands for our NumPy renderer in the place of a folder of official renderings."""
PLACES = ("dataset", "scene", "method")
PLACE = re.compile(r"\{\{|\}\}|\{(.*?)\}")
"""A placeholder in a path; doubled braces stand for single ones."""
_NAME = r"^[^/\\\x00-\x1f.][^/\\\x00-\x1f]*$"
"""A name that becomes the name of a folder below the results."""

FolderName = Annotated[str, Field(pattern=_NAME, max_length=100)]
Template = Annotated[str, Field(min_length=1)]
"""A path relative to the protocol file, in which {dataset}, {scene} and {method} are placeholders."""
Unit = Annotated[float, Field(ge=0, le=1)]
Color = tuple[Unit, Unit, Unit]
Setting = bool | int | float | str


class _Table(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, protected_namespaces=()
    )


class SceneOptions(_Table):
    """Options of a scene, set by its dataset; where a method sets one too, the method counts.

    Attributes
    ----------
    image_folder : str, optional
        The folder below the scene, such as "images_4"; the dataset's folder if not given.
    resolution : int, optional
        The resolution, with the meaning of ``-r`` in the 3DGS family.
    background : (3,) floats in [0, 1], optional
    camera_convention : {"gs_fov", "full_K"}, optional
        The camera that the method was trained with; by default "full_K" for DiffSoup, "gs_fov" for all
        others.
    """

    image_folder: Annotated[str, Field(min_length=1)] | None = None
    resolution: int | None = None
    background: Color | None = None
    camera_convention: Literal["gs_fov", "full_K"] | None = None


class DatasetTable(SceneOptions):
    """``[[datasets]]``: scenes of one dataset in one folder.

    Attributes
    ----------
    name : str
        "mipnerf360", "tanksandtemples", "nerf_synthetic", "dtu", or any other for a capture of your own.
    path : str
        The folder that holds the scenes' folders.
    scenes : tuple of str
        The names of the scenes; all scenes in the folder, if not given.
    """

    name: FolderName
    path: Annotated[str, Field(min_length=1)]
    scenes: tuple[FolderName, ...] = ()


class MethodTable(SceneOptions):
    """``[[methods]]``: where one method's models are, and what belongs to them.

    Attributes
    ----------
    name : str
        A name that `msb methods` lists, or "auto", which takes the method found from the model.
    label : str, optional
        Names the model's columns and folders, and tells it from others of its method. It may be no method's
        name.
    model : str, optional
        The template of the checkpoint, .triasset or mesh of each scene. Without it there are official
        renderings only.
    datasets : tuple of str
        The names of the datasets that the method is evaluated on; all, if not given.
    settings : mapping
        Values that replace settings, as ``--set`` takes them.
    conditions : tuple of Condition, optional
        The conditions; those of the protocol, if not given.
    non_engine : str, optional
        The template of the folder of official renderings, or "reference". Without it there is no such cell.
    non_engine_timing : str, optional
        The template of the file that says how fast the method's own renderer is (`msb.renderer_timing/1`).
    training : str, optional
        The template of the file that `msb track` wrote.
    mesh : str, optional
        The template of the mesh whose Chamfer distance is measured; the asset's own triangles if not given.
    """

    name: str = AUTO
    label: FolderName | None = None
    model: Template | None = None
    datasets: tuple[FolderName, ...] = ()
    settings: dict[str, Setting] = {}
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] | None = None
    non_engine: Template | None = None
    non_engine_timing: Template | None = None
    training: Template | None = None
    mesh: Template | None = None


class VariantTable(_Table):
    """``[[variants]]``: a condition of its own, drawn on the dedicated tier in another way than officially.

    Attributes
    ----------
    label : str
        Names the condition. It may be no condition's, no engine's and no other variant's name.
    order, sampling : str, optional
        As ``--order`` and ``--sampling`` of `msb render` take them; official if not given.
    renderer : str, optional
        A renderer that draws the dedicated tier, by its name in `msb devices`; ours if not given.
    settings : mapping
        Overrides, as ``--set`` takes them, on top of the method's.
    """

    label: FolderName
    order: Order | None = None
    sampling: Sampling | None = None
    renderer: Annotated[str, Field(min_length=1)] | None = None
    settings: dict[str, Setting] = {}

    @property
    def options(self) -> dict[str, str]:
        """What of `order` and `sampling` is given, as a renderer takes it."""
        given = {"order": self.order, "sampling": self.sampling}
        return {name: value for name, value in given.items() if value is not None}


class MetricsTable(_Table):
    """``[metrics]``: `vgg_weights` is the file of torchvision's VGG16, without which LPIPS is "--"."""

    vgg_weights: str | None = None


class TimingTable(_Table):
    """``[timing]``: the clock runs for at least `frames` and `seconds`; 0 frames mean no timing."""

    frames: Annotated[int, Field(ge=0)] = Timing.frames
    seconds: Annotated[float, Field(ge=0)] = Timing.seconds


class ChamferTable(_Table):
    """``[chamfer]``, for scenes of DTU: the official evaluation data, and the seed of the sampling."""

    data: Annotated[str, Field(min_length=1)]
    seed: Annotated[int, Field(ge=0)] = 0


class VideosTable(_Table):
    """``[videos]``: films that show conditions side by side along a path.

    The `path` "flight" goes smoothly through the test cameras; "test" shows the test views themselves, and
    beside them the photographs and the official renderings.
    """

    path: Literal["flight", "test"] = "flight"
    frames: Annotated[int, Field(ge=2, le=100_000)] = 120
    fps: Annotated[int, Field(ge=1, le=240)] = 24


class TrialTable(_Table):
    """``[trial]``: tasks that are tried on the exported mesh, and the limits of each library for each task.

    Attributes
    ----------
    tasks : tuple of str
        Names of tasks as `msb trial --task` takes them; all, if not given.
    compare : bool
        Whether ways to repair the mesh are compared, as `msb repair --compare` does, and tried by the `tasks`
        given, else by those of that command.
    seconds : float
    memory : float
        GiB.
    """

    tasks: tuple[str, ...] = ()
    compare: bool = False
    seconds: Annotated[float, Field(gt=0)] = 60.0
    memory: Annotated[float, Field(gt=0)] = 4.0


class Protocol(_Table):
    """The whole file. docs/protocol.md has it with comments."""

    results: Annotated[str, Field(min_length=1)] = "results"
    device: str | None = None
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] = CONDITIONS
    engines: tuple[FolderName, ...] = ()
    datasets: Annotated[tuple[DatasetTable, ...], Field(min_length=1)]
    methods: Annotated[tuple[MethodTable, ...], Field(min_length=1)]
    variants: tuple[VariantTable, ...] = ()
    metrics: MetricsTable = MetricsTable()
    timing: TimingTable = TimingTable()
    chamfer: ChamferTable | None = None
    videos: VideosTable | None = None
    trial: TrialTable | None = None
