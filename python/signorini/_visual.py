"""What a body looks like; without physics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from signorini._world import Shape

Array = NDArray[np.float64]
Color = tuple[float, float, float, float]


@dataclass(frozen=True)
class MeshFile:
    """A mesh in a file, read by those who draw it. scale: (x, y, z), of the file's own coordinates. part: name of the
    one piece of the file that is meant; empty: all of it."""

    path: Path
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    part: str = ""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """vertices: (n, 3) [m]; triangles: (m, 3), winding outwards."""

    vertices: Array
    triangles: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Visual:
    """Something to look at, at a place in a body: x_body = rotation x + position. color: red, green, blue, opacity,
    each in [0, 1]; None: the mesh's own, or as the viewer likes."""

    body: str
    shape: Shape | MeshFile | TriangleMesh
    position: Array
    rotation: Array
    color: Color | None = None
