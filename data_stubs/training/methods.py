"""The methods that can be trained."""

from __future__ import annotations

from typing import TYPE_CHECKING

from data_stubs.training.lattices import DiffSoup
from data_stubs.training.mesh import MeshSplatting
from data_stubs.training.soups import TriangleSplatting, TwoDTS
from data_stubs.training.splats import DiscSplatting, GaussianSplatting

if TYPE_CHECKING:
    from data_stubs.training.model import Model

MODELS: dict[str, type[Model]] = {
    model.method: model
    for model in (TwoDTS, TriangleSplatting, MeshSplatting, DiffSoup, GaussianSplatting, DiscSplatting)
}
