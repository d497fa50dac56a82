"""What a caller says about one file, and what the readers share when they talk to a WorldBuilder."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from signorini.load import mesh
from signorini.load._placement import Placement, identity

if TYPE_CHECKING:
    from signorini._world import Material, WorldBuilder


@dataclass(frozen=True)
class Options:
    """See add_file()."""

    prefix: str = ""
    placement: Placement = field(default_factory=identity)
    floating_base: bool | None = None
    package_dirs: Sequence[Any] = ()
    material: Material | Mapping[str, Material] | None = None
    motors: bool = True
    hull_vertices: int | None = mesh.HULL_VERTICES
    repair_inertia: bool = False

    def material_of(self, body: str) -> Material | None:
        """The material asked for the geometries of a body (its name in the file); None: the file's or the default."""
        if isinstance(self.material, Mapping):
            found = (material for pattern, material in self.material.items() if fnmatchcase(body, pattern))
            return next(found, None)
        return self.material


@dataclass
class Added:
    """What one file put into a builder: bodies and geometries by name in the world and index. models: of a file with
    several, the one that a body is in."""

    file: Path
    bodies: list[str] = field(default_factory=list)
    geometries: list[int] = field(default_factory=list)
    body_of_geometry: dict[int, str] = field(default_factory=dict)
    models: dict[str, str] = field(default_factory=dict)

    def together(self, body_a: str, body_b: str) -> bool:
        """Whether two bodies are of one robot."""
        return self.models.get(body_a) == self.models.get(body_b)


class Warnings:
    """Collects what is not carried over, one line a reason with the elements it concerns."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._names: dict[str, list[str]] = defaultdict(list)

    def add(self, reason: str, *names: str) -> None:
        self._names[reason].extend(names)

    def tell(self, builder: WorldBuilder) -> None:
        for reason, names in self._names.items():
            shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
            builder.warn(f"{self._file.name}: {reason}" + (f": {shown}" if shown else ""))
