"""What a caller says about one file, and what the readers share when they talk to a WorldBuilder."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from signorini.load import mesh
from signorini.load._placement import Placement, identity

if TYPE_CHECKING:
    from signorini._world import Material, WorldBuilder


#: What the numbers of a file that make contacts, limits and equalities soft become: "file": springs where the file sets
#: them, rigid where it does not; "rigid": rigid all; "all": springs also where the format's defaults count.
Compliance = Literal["file", "rigid", "all"]


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
    compliance: Compliance = "file"
    decompose: bool | Sequence[str] = False

    def material_of(self, body: str) -> Material | None:
        """The material asked for the geometries of a body (its name in the file); None: the file's or the default."""
        if isinstance(self.material, Mapping):
            found = (material for pattern, material in self.material.items() if fnmatchcase(body, pattern))
            return next(found, None)
        return self.material

    def splits(self, body: str) -> bool:
        """Whether concave meshes of a body (its name in the file) are decomposed."""
        if isinstance(self.decompose, bool):
            return self.decompose
        return any(fnmatchcase(body, pattern) for pattern in self.decompose)


@dataclass
class Added:
    """What one file put into a builder: bodies and geometries by name in the world and index; hulls: what the meshes
    among them became; mended: bodies whose inertia in the file no body can have; models: of a file with several, the
    one that a body is in."""

    file: Path
    bodies: list[str] = field(default_factory=list)
    geometries: list[int] = field(default_factory=list)
    body_of_geometry: dict[int, str] = field(default_factory=dict)
    hulls: dict[int, mesh.Hull] = field(default_factory=dict)
    mended: list[str] = field(default_factory=list)
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

    def add_hulls(self, name: str, hulls: Sequence[mesh.Hull]) -> None:
        """What there is to say about the hulls of one mesh."""
        for note in hulls[0].notes:
            self.add("meshes", f"{name} {note}")
        added = hulls[0].added
        if len(hulls) == 1 and added is not None and added > mesh.MUCH:
            reason = f"hulls that add more than {mesh.MUCH:.0%} to the volume of their mesh (decompose= splits them)"
            self.add(reason, f"{name} ({added:.0%})")

    def tell(self, builder: WorldBuilder) -> None:
        for reason, names in self._names.items():
            shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
            builder.warn(f"{self._file.name}: {reason}" + (f": {shown}" if shown else ""))
