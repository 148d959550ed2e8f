"""Compare the renderer tiers of a model: the function `msb.compare`.

The command `msb compare` calls the same code.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from msb.api.opening import as_asset
from msb.asset import Asset
from msb.asset.settings import effective_settings
from msb.base.atomic import check_new, check_place, new_file
from msb.base.paths import given_path
from msb.errors import UsageError, about
from msb.meshes.assets import align_baked
from msb.render.options import SceneOptions, Up, ViewOptions, check_factor
from msb.scenes.around import make_turntable
from msb.scenes.colors import Color, check_background
from msb.scenes.datasets import default_background, stated_background, warn_background
from msb.views import choose_views
from msb_viewers.deployment.compose import compose
from msb_viewers.deployment.page import page, page_view
from msb_viewers.deployment.shots import Comparison, Shot, TierRenderers, choose_tiers
from msb_viewers.deployment.state import LAYOUTS, CompareState, Layout
from msb_viewers.deployment.views import View, scene_views, views_at
from msb_viewers.sheet import write_png

# Turntable for models without cameras: number of views, width and height in pixels. Large images of training
# cameras are scaled down so that their longer side has 640 pixels.
TURNTABLE = (8, 640, 480)

Note = Callable[[str], None]
# A context manager that counts the rendered views. The arguments of the context manager are a title and a
# total. The context manager yields a function to call after each view.
Counted = Callable[[str, int], AbstractContextManager[Callable[[], None]]]


@dataclass(frozen=True)
class Compared:
    """The result of `compare`.

    Attributes
    ----------
    tiers : tuple of str
        The compared tiers, including "truth" for photographs and "baked" for a baked mesh.
    missing : mapping of str to str
        For each missing tier, the reason why the tier has no image.
    psnr : mapping of str to mapping
        For each view name, the PSNR in dB of each pair of tiers in alphabetical order. For equal images, the
        PSNR is infinity. If a pair of tiers does not have two images of equal size, it is omitted.
    written : tuple of Path
        The written files.
    notes : tuple of str
        Warnings, such as an omitted tier or photographs that were not found.
    """

    tiers: tuple[str, ...]
    missing: Mapping[str, str]
    psnr: Mapping[str, Mapping[tuple[str, str], float]]
    written: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()


def compare(
    asset: Asset | str | os.PathLike[str],
    scene: str | os.PathLike[str] | None = None,
    *,
    html: str | os.PathLike[str] | None = None,
    screenshot: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    views: Sequence[str] = (),
    tiers: Sequence[str] = (),
    baked: Asset | str | os.PathLike[str] | None = None,
    image_folder: str | os.PathLike[str] | None = None,
    scale: float | None = None,
    layout: Layout = "side",
    pair: tuple[str, str] | None = None,
    background: Sequence[float] | str | None = None,
    settings: Mapping[str, Any] | None = None,
    supersample: int = 1,
    device: str | None = None,
    up: Up | None = None,
    size: tuple[int, int] = (1280, 800),
) -> Compared:
    """Compare the renderer tiers of a model with each other and with photographs, like `msb compare`.

    Parameters
    ----------
    asset : Asset or path-like
        The asset, or a path that `msb.open` accepts.
    scene : path-like, optional
        The views and their photographs. A folder is a scene of a dataset, and its test views are compared.
        A file contains cameras (`msb.read_cameras`). By default, the training cameras next to the model are
        used. A model without training cameras is shown from a turntable.
    html, screenshot : path-like, optional
        Write a page of all views, and an image (.png) of the first view. If only `screenshot` is given,
        only the first view is rendered.
    overwrite : bool
        Replace existing files.
    views : sequence of str
        Names or numbers of the cameras of `scene`. For a folder, "train" and "all" are also accepted.
        Default: the test views of a folder, or all cameras of a file.
    tiers : sequence of str
        One or more of "reference", "dedicated", "standard", "baked" and "truth" (photographs). Default: all
        tiers.
    baked : Asset or path-like, optional
        Also compare this mesh, made by `msb.bake` from the model.
    image_folder : path-like, optional
        The folder of the photographs: its name in the scene. For a file of cameras, any path is accepted.
    scale : float, optional
        Size of the images relative to the cameras, as in `msb compare --scale`.
    layout : {"side", "wipe", "difference"}
        Layout of the screenshot. The first layout of the page is the same.
    pair : (str, str), optional
        The two tiers that wipe and difference compare.
    background, settings, supersample, device
        As in `msb.render`.
    up : {"+x", "-x", "+y", "-y", "+z", "-z"}, optional
        The axis of a turntable. Default: the up axis of the asset.
    size : (int, int)
        Width and height of the screenshot in pixels.

    Returns
    -------
    Compared

    Raises
    ------
    UsageError
        An option is invalid, or a file exists and `overwrite` is false.
    InputError, SceneError and the errors of `msb.open` and `msb.Renderer`
        An input cannot be read or rendered.

    Examples
    --------
    >>> import msb
    >>> found = msb.compare("data_stubs/checkpoint", "data_stubs/views.json", views=["0"], scale=0.25)
    >>> found.tiers, sorted(next(iter(found.psnr.values())))
    (('reference', 'dedicated', 'standard'),
     [('dedicated', 'reference'), ('dedicated', 'standard'), ('reference', 'standard')])
    """
    if scene is None and (views or image_folder is not None or scale is not None):
        raise UsageError("USAGE", "views, image_folder and scale need a scene")
    if layout not in LAYOUTS:
        raise UsageError("USAGE", f"layout is {layout!r}; use one of {', '.join(LAYOUTS)}")
    if scale is not None:
        check_factor(scale)
    # Check the outputs before reading files.
    page_path, image_path = (None if path is None else given_path(path) for path in (html, screenshot))
    for path, endings in ((page_path, (".html", ".htm")), (image_path, (".png",))):
        if path is None:
            continue
        if path.suffix.lower() not in endings:
            raise UsageError("USAGE", f"the path must end in {' or '.join(endings)}", file=path)
        check_place(path)
        if not overwrite:
            check_new(path)
    opened = as_asset(asset)
    color = None
    if background is not None:
        color = check_background(background, opened.manifest.appearance.get("background"))
    place = opened.opened_from if isinstance(asset, Asset) else given_path(asset)
    notes = [warning.to_line(place) for warning in opened.warnings]
    views_path = None if scene is None else given_path(scene)
    folder = views_path if views_path is not None and views_path.is_dir() else None
    request = Request(
        cameras=ViewOptions(None if folder else views_path, tuple(map(str, views))),
        scene=folder,
        background=color,
        image_folder=None if image_folder is None else given_path(image_folder),
        scale=scale,
        layout=layout,
        tiers=tuple(tiers),
        baked=None if baked is None else align_baked(as_asset(baked), opened),
        pair=None if pair is None else ",".join(pair),
        settings=settings or {},
        supersample=supersample,
        device=device,
        up=up,
    )
    state = request.read(opened, place, notes.append)
    done = write(state, page_path, image_path, size)
    return replace(done, notes=tuple(notes))


@dataclass(frozen=True)
class Request:
    """The views, renderer tiers and options of a comparison.

    `cameras` selects the views. The views come from a file of cameras, or from the dataset folder `scene`.
    """

    cameras: ViewOptions
    scene: Path | None = None
    reading: SceneOptions = field(default_factory=SceneOptions)
    background: Color | None = None  # default: the background of the scene, otherwise of the asset
    image_folder: Path | None = None
    scale: float | None = None
    layout: Layout = "side"
    tiers: tuple[str, ...] = ()
    baked: Asset | None = None
    pair: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    supersample: int = 1
    device: str | None = None
    up: Up | None = None

    def read(self, asset: Asset, place: Path | None, note: Note) -> CompareState:
        """Read cameras and photographs. `place` is the path of the model for titles and notes."""
        source = ""
        color = self.background or default_background(asset.manifest)
        if self.scene is not None:
            folder = None if self.image_folder is None else str(self.image_folder)
            scene = replace(self.reading, image_folder=folder).read(asset, self.scene, note)
            views = scene_views(scene, self.cameras.of_scene(scene)[1], self.scale)
            color = self.background or scene.background
        elif self.cameras.cameras is not None:
            source_path = self.cameras.cameras
            cameras = self.cameras.read(note)
            views = views_at(cameras, source_path, self.image_folder, self.scale)
        else:
            views, source = self._choose(asset)
        comparison = self._comparison(asset, place, views, color, note)
        with about(place):
            state = CompareState.first(comparison, layout=self.layout, pair=self.pair)
        if source:
            note(f"views: {source}")
        return state

    def _comparison(
        self, asset: Asset, place: Path | None, views: list[View], color: Color, note: Note
    ) -> Comparison:
        name = "asset" if place is None else place.name
        photographs = any(view.photograph for view in views)
        if self.cameras.cameras is not None and not photographs:
            note(f"{self.cameras.cameras}: no photographs were found for these cameras; pass --image-folder")
        tiers, missing = choose_tiers(asset, views, self.tiers or None, baked=self.baked)
        if not self.tiers and "reference" not in tiers:
            text = (
                f"{asset.manifest.face_count:,} faces take minutes per view; to include this tier, "
                "name it in --tiers"
            )
            note(f"{name}: the reference tier is omitted: {text}")
        effective_settings(asset.manifest, self.settings)  # rejects invalid settings
        stated = stated_background(asset.manifest)
        if stated not in (None, color) and photographs:
            note(warn_background(stated, color).to_line(place))
        content = (
            name,
            asset,
            tiers,
            missing,
            tuple(views),
            self.settings,
            self.supersample,
            color,
        )
        return Comparison(*content, self.device, self.baked)

    def _choose(self, asset: Asset) -> tuple[list[View], str]:
        """Return views for a model without a scene, and a description of the views.

        The views are on a turntable around the axis `up`.
        """
        chosen = choose_views(asset, device=self.device, kind=self.cameras.kind)
        if chosen.origin == "turntable":
            cameras = make_turntable(asset, *TURNTABLE, up=self.up)
            views = [View(f"view {index}", camera, why="") for index, camera in enumerate(cameras, 1)]
            return views, chosen.description
        views = views_at(chosen.cameras, chosen.place or Path(), None, None)
        # Scale down large training views.
        sizes = [min(1.0, max(TURNTABLE[1:]) / max(view.camera.width, view.camera.height)) for view in views]
        return [
            replace(view, camera=view.camera.scaled(size)) for view, size in zip(views, sizes, strict=True)
        ], chosen.description


@contextmanager
def _uncounted(_text: str, _total: int) -> Iterator[Callable[[], None]]:
    yield lambda: None


def write(
    state: CompareState,
    html: Path | None,
    screenshot: Path | None,
    size: tuple[int, int],
    counted: Counted = _uncounted,
) -> Compared:
    """Render the views.

    Write the page and the image of the first view, if the paths of these files are set.
    """
    scene = state.comparison
    only_first = html is None and screenshot is not None
    views = scene.views[:1] if only_first else scene.views
    with TierRenderers(scene) as renderers:
        # The page shows all views on all tiers. An image of a comparison needs only the first view, and only
        # the tiers that the layout shows.
        rows: list[dict[str, Any]] = []
        first: dict[str, Shot] = {}
        with counted("drawing", len(views)) as step:
            for view in views:
                shots = renderers.shoot_all(view, state.wanted_tiers() if only_first else None)
                first = first or shots
                rows.append(page_view(view, shots))
                step()
        if html is not None:
            with new_file(html) as file:
                file.write(page(state, rows))
        if screenshot is not None:
            write_png(compose(state, first, size).image, screenshot)
    return Compared(
        tiers=scene.tiers,
        missing=dict(scene.missing),
        psnr={row["name"]: _read_decibels(row["decibels"]) for row in rows},
        written=tuple(path for path in (html, screenshot) if path is not None),
    )


def _read_decibels(values: Mapping[str, float | str]) -> dict[tuple[str, str], float]:
    """Return the PSNR in dB of each pair of tiers.

    On the page, one text contains both names of a pair of tiers.
    """
    pairs = {}
    for names, value in values.items():
        a, b = names.split()
        pairs[a, b] = math.inf if isinstance(value, str) else value
    return pairs
