"""Robot files -> worlds.

    world = signorini.load("robot.urdf", floating_base=True, ground=True)

Several files in one world:

    builder = signorini.WorldBuilder()
    builder.add_file("arm.urdf", prefix="left/", position=(0.0, 0.5, 0.0))
    builder.add_file("arm.urdf", prefix="right/", position=(0.0, -0.5, 0.0))
    world = builder.build()

What is read of each format, and the rules: docs/robot_files.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from signorini import _arrays
from signorini._core import InvalidInputError
from signorini._files import checked
from signorini.load import _xml, mesh
from signorini.load._ground import add_touching_ground
from signorini.load._options import Added, Compliance, Options
from signorini.load._placement import Placement, from_quaternion

if TYPE_CHECKING:
    from signorini._world import Material, World, WorldBuilder

WORLD = "world"
__all__ = ["Added", "add_file", "exclude_overlapping_pairs", "file_format", "load"]

Format = Literal["urdf", "mjcf", "sdf"]
PathLike = str | os.PathLike[str]
Result = TypeVar("Result")
GRAVITY = (0.0, 0.0, -9.81)
HIGHEST = 1e9  # [m] of a ground


def load(
    path: PathLike,
    *,
    format: Format | None = None,
    ground: bool | float | Literal["touching"] = False,
    gravity: Sequence[float] | None = None,
    prefix: str = "",
    position: Sequence[float] = (0.0, 0.0, 0.0),
    orientation: npt.ArrayLike = (0.0, 0.0, 0.0, 1.0),
    floating_base: bool | None = None,
    package_dirs: Iterable[PathLike] = (),
    srdf: PathLike | None = None,
    material: Material | Mapping[str, Material] | None = None,
    ground_material: Material | None = None,
    motors: bool = True,
    self_collision: bool = True,
    exclude_overlapping: bool | Callable[[World], npt.ArrayLike] | None = None,
    hull_vertices: int | None = mesh.HULL_VERTICES,
    repair_inertia: bool = False,
    compliance: Compliance = "file",
    decompose: bool | str | Iterable[str] = False,
    builder: WorldBuilder | None = None,
) -> World:
    """Builds a world from a robot file (URDF, MJCF, SDF).

    format: None: by the file's root element. ground: True adds a half space below z = 0, a number one below that height
    [m], "touching" one that the lowest point of what moves just touches at initial_q; of `ground_material`. gravity:
    [m/s^2]; None: the file's, else (0, 0, -9.81). exclude_overlapping: pairs of bodies of this robot that overlap at
    initial_q never touch, and world.warnings lists them; a function of the world that returns a configuration (nq,)
    adds one to look at; None: False for MJCF, which lists its own, else True. builder: to add to; then `gravity`
    must not be given. The other arguments: see add_file().

    What a file asks for and the world does not have is listed in world.warnings. Raises InvalidInputError naming file,
    line and element, and what is allowed.
    """
    options = _options(
        prefix=prefix,
        position=position,
        orientation=orientation,
        floating_base=floating_base,
        package_dirs=package_dirs,
        material=material,
        motors=motors,
        hull_vertices=hull_vertices,
        repair_inertia=repair_inertia,
        compliance=compliance,
        decompose=decompose,
    )
    loaded = assemble(
        checked(path),
        options,
        format=format,
        ground=ground,
        gravity=gravity,
        srdf=srdf,
        ground_material=ground_material,
        self_collision=self_collision,
        exclude_overlapping=exclude_overlapping,
        builder=builder,
    )
    return loaded.world


@dataclass(frozen=True)
class Loaded:
    """A world, what it was built by, and what the file added to that."""

    world: World
    builder: WorldBuilder
    added: Added


def assemble(
    path: Path,
    options: Options,
    *,
    format: Format | None = None,
    ground: bool | float | Literal["touching"] = False,
    gravity: Sequence[float] | None = None,
    srdf: PathLike | None = None,
    ground_material: Material | None = None,
    self_collision: bool = True,
    exclude_overlapping: bool | Callable[[World], npt.ArrayLike] | None = None,
    builder: WorldBuilder | None = None,
) -> Loaded:
    """load() for those who need the builder too."""
    from signorini._world import WorldBuilder

    height = _ground_height(ground, ground_material)
    if exclude_overlapping is not None and not callable(exclude_overlapping):
        exclude_overlapping = _arrays.flag("exclude_overlapping", exclude_overlapping)
    if builder is not None and not isinstance(builder, WorldBuilder):
        raise InvalidInputError(f"builder: is a {type(builder).__name__}, must be a signorini.WorldBuilder")
    format = format or file_format(path)
    source = _read(path, format, options)
    if builder is None:
        builder = _named(path, lambda: WorldBuilder(source.gravity or GRAVITY if gravity is None else gravity))
    elif gravity is not None:
        raise InvalidInputError("gravity: must not be given together with a builder, which has its own")
    added = _add(builder, source, options, self_collision, srdf)
    if isinstance(height, float):
        builder.add_ground(ground_material, height)
    if exclude_overlapping is None:
        exclude_overlapping = format != "mjcf"
    world = _named(path, builder.build)
    if exclude_overlapping is not False:
        configurations = [world.initial_q]
        if callable(exclude_overlapping):
            configurations.append(_arrays.vector("exclude_overlapping", exclude_overlapping(world), world.num_q))
        if exclude_overlapping_pairs(builder, world, [added], configurations):
            world = _named(path, builder.build)
    if height == "touching":
        add_touching_ground(builder, world, path.name, ground_material)
        world = _named(path, builder.build)
    return Loaded(world, builder, added)


def add_file(
    builder: WorldBuilder,
    path: PathLike,
    *,
    format: Format | None = None,
    prefix: str = "",
    position: Sequence[float] = (0.0, 0.0, 0.0),
    orientation: npt.ArrayLike = (0.0, 0.0, 0.0, 1.0),
    floating_base: bool | None = None,
    package_dirs: Iterable[PathLike] = (),
    srdf: PathLike | None = None,
    material: Material | Mapping[str, Material] | None = None,
    motors: bool = True,
    self_collision: bool = True,
    hull_vertices: int | None = mesh.HULL_VERTICES,
    repair_inertia: bool = False,
    compliance: Compliance = "file",
    decompose: bool | str | Iterable[str] = False,
) -> Added:
    """Adds what is in a robot file to a builder; returns the names and indices of what was added.

    format: None: by the file's root element. prefix: of every name. position [m], orientation (quaternion x y z w or
    3 x 3): of the robot's root in the world. floating_base: True hangs a URDF's root on a free joint "root_joint",
    False fixes what floats in an SDF file; None: fixed (URDF), as the file says (SDF; always MJCF). package_dirs:
    folders that hold packages or are one, for package:// names. srdf: file whose disabled pairs of links never touch.
    material: for all geometries, or by body, {name or pattern: material}, the first that fits, and each fits a body;
    else the file's (MJCF, SDF) or the default. motors: one on each joint of one value (URDF, SDF), the file's (MJCF).
    self_collision: False: bodies of this robot never touch each other. hull_vertices: largest number of vertices of a
    mesh's hull; None: no limit. repair_inertia: inertias that no body can have are mended and not refused. compliance:
    what MJCF's solref and solimp become: "file": springs with dampers where the file sets them, rigid where it does
    not; "rigid": rigid; "all": springs everywhere (docs/robot_files.md). decompose: concave meshes, of all bodies or of
    those of this name, pattern or list, become several convex pieces, "name_0", "name_1", ...; ImportError without the
    package coacd.

    Raises InvalidInputError naming file, line and element, and what is allowed. What had been added by then stays in
    the builder.
    """
    path = checked(path)
    options = _options(
        prefix=prefix,
        position=position,
        orientation=orientation,
        floating_base=floating_base,
        package_dirs=package_dirs,
        material=material,
        motors=motors,
        hull_vertices=hull_vertices,
        repair_inertia=repair_inertia,
        compliance=compliance,
        decompose=decompose,
    )
    return _add(builder, _read(path, format, options), options, self_collision, srdf)


def file_format(path: PathLike) -> Format:
    """What a file is, by its root element. Raises InvalidInputError when it is none of what is read."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".xacro":
        raise InvalidInputError(f"{path}: is xacro, not URDF; expand it first: xacro FILE.xacro > FILE.urdf")
    if suffix not in (".urdf", ".xml", ".mjcf", ".sdf", ".world", ""):
        raise InvalidInputError(f'{path}: has suffix "{suffix}"; robot files are .urdf, .xml, .mjcf or .sdf')
    tag = _xml.root_tag(path)
    if tag == "robot":
        return "urdf"
    if tag in ("mujoco", "mujocoinclude"):
        return "mjcf"
    if tag == "sdf":
        return "sdf"
    raise InvalidInputError(f"{path}: its root is <{tag}>, must be <robot> (URDF), <mujoco> (MJCF) or <sdf>")


def exclude_overlapping_pairs(
    builder: WorldBuilder, world: World, added: Iterable[Added], configurations: Iterable[npt.ArrayLike] | None = None
) -> list[tuple[str, str]]:
    """Excludes in the builder every pair of bodies of one robot that overlaps in one of the configurations.

    world: what the builder builds now. added: what add_file() returned. configurations: each (nq,); None: the initial
    one. Returns the pairs, which are also in builder.warn; build again when there are any.
    """
    found: dict[tuple[str, str], float] = {}
    files = list(added)
    for q in [world.initial_q] if configurations is None else configurations:
        for a, b, distance in world.touching_pairs(np.asarray(q, dtype=np.float64), 0.0):
            for file in files:
                pair = file.body_of_geometry.get(a, ""), file.body_of_geometry.get(b, "")
                if all(pair) and file.together(*pair) and distance < 0.0:
                    found[pair] = min(found.get(pair, 0.0), distance)
    for pair in found:
        if WORLD not in pair:
            builder.exclude(*pair)
            continue
        owner = next(file for file in files if set(pair) & set(file.bodies)).body_of_geometry
        for a, b in product(*([g for g, body in owner.items() if body == one] for one in pair)):
            builder.exclude_geometries(a, b)  # not the bodies: the world may have others, like a ground
    if found:
        listed = ", ".join(f"{a} and {b} ({-1e3 * depth:.2g} mm)" for (a, b), depth in found.items())
        builder.warn(f"bodies that overlap at the start never touch: {listed}")
    return list(found)


def _options(
    *,
    prefix: str,
    position: Sequence[float],
    orientation: npt.ArrayLike,
    floating_base: bool | None,
    package_dirs: Iterable[PathLike],
    material: Material | Mapping[str, Material] | None,
    motors: bool,
    hull_vertices: int | None,
    repair_inertia: bool,
    compliance: Compliance,
    decompose: bool | str | Iterable[str],
) -> Options:
    if compliance not in ("file", "rigid", "all"):
        raise InvalidInputError(f"compliance: is {compliance!r}, must be 'file', 'rigid' or 'all'")
    _check_materials(material)
    return Options(
        _arrays.text("prefix", prefix),
        Placement(_rotation(orientation), _position(position)),
        None if floating_base is None else _arrays.flag("floating_base", floating_base),
        _tuple("package_dirs", package_dirs, (str, os.PathLike), "folders"),
        material,
        _arrays.flag("motors", motors),
        None if hull_vertices is None else _arrays.count("hull_vertices", hull_vertices, 4),
        _arrays.flag("repair_inertia", repair_inertia),
        compliance,
        decompose if isinstance(decompose, bool) else _tuple("decompose", decompose, str, "a bool, or names of bodies"),
    )


def _tuple(field: str, given: Any, kind: Any, wanted: str) -> tuple[Any, ...]:
    """Of one or several."""
    values = (given,) if isinstance(given, kind) or not isinstance(given, Iterable) else tuple(given)
    if not all(isinstance(value, kind) for value in values):
        raise InvalidInputError(f"{field}: is {given!r}, must be {wanted}")
    return values


def _check_materials(material: Any) -> None:
    from signorini._world import Material

    by_body = isinstance(material, Mapping)
    for body, value in material.items() if by_body else [("", material)]:
        field = f"material[{_arrays.text('material', body)!r}]" if by_body else "material"
        if not isinstance(value, Material) and (by_body or value is not None):
            wanted = "a signorini.Material" + ("" if by_body else ", these by body, or None")
            raise InvalidInputError(f"{field}: is {value!r}, must be {wanted}")


def _ground_height(ground: Any, material: Any) -> float | Literal["touching"] | None:
    """[m]; None: no ground."""
    from signorini._world import Material

    if material is not None and not isinstance(material, Material):
        raise InvalidInputError(f"ground_material: is {material!r}, must be a signorini.Material, or None")
    if isinstance(ground, (bool, np.bool_)):
        return 0.0 if ground else None
    if isinstance(ground, str) and ground == "touching":
        return "touching"
    if isinstance(ground, (int, float, np.integer, np.floating)) and abs(ground) <= HIGHEST:
        return float(ground)
    raise InvalidInputError(f'ground: is {ground!r}, must be True, False, a height within +-1e9 m, or "touching"')


def _position(position: Sequence[float]) -> npt.NDArray[np.float64]:
    array = _arrays.vector("position", position, 3)
    if not np.isfinite(array).all():
        raise InvalidInputError(f"position: is {position}, must be 3 finite numbers")
    return array


def _rotation(orientation: npt.ArrayLike) -> npt.NDArray[np.float64]:
    array = _arrays.numbers("orientation", orientation)
    if array.shape == (4,) and abs(float(np.linalg.norm(array)) - 1.0) < 1e-6:
        return from_quaternion(array / np.linalg.norm(array))
    if array.shape == (3, 3) and np.allclose(array @ array.T, np.eye(3), atol=1e-6) and np.linalg.det(array) > 0.0:
        return array
    raise InvalidInputError("orientation: must be a unit quaternion (x, y, z, w) or a 3 x 3 rotation matrix")


class _Source(Protocol):
    """A file that was read."""

    @property
    def gravity(self) -> tuple[float, float, float] | None: ...

    def add(self, builder: WorldBuilder, options: Options) -> Added: ...


def _read(path: Path, format: Format | None, options: Options) -> _Source:
    format = format or file_format(path)
    if format == "urdf":
        from signorini.load import urdf

        return urdf.read(path)
    if format == "mjcf":
        from signorini.load import mjcf

        return mjcf.read(path)
    if format == "sdf":
        from signorini.load import sdf

        return sdf.read(path, options.package_dirs)
    raise InvalidInputError(f"format: is {format!r}, must be 'urdf', 'mjcf', 'sdf' or None")


def _add(
    builder: WorldBuilder, source: _Source, options: Options, self_collision: bool, srdf: PathLike | None
) -> Added:
    _arrays.flag("self_collision", self_collision)
    if srdf is not None and not isinstance(srdf, (str, os.PathLike)):
        raise InvalidInputError(f"srdf: is {srdf!r}, must be a path, or None")
    added = source.add(builder, options)
    _check_patterns("decompose", options.decompose, added, options.prefix)
    _check_patterns("material", options.material, added, options.prefix)
    theirs, ours = source.gravity, getattr(builder, "gravity", None)
    if theirs is not None and ours is not None and not np.allclose(theirs, ours):
        builder.warn(f"{added.file.name}: gravity is {theirs} there, and {tuple(ours)} in this world")
    if srdf is not None:
        from signorini.load import srdf as reader

        known = set(added.bodies)
        for pair in reader.read(Path(srdf)).disabled:
            body_a, body_b = (options.prefix + name for name in pair)
            if body_a in known and body_b in known:
                builder.exclude(body_a, body_b)
    if not self_collision:
        bodies = [body for body in dict.fromkeys(added.body_of_geometry.values()) if body != WORLD]
        for i, body in enumerate(bodies):
            for other in bodies[:i]:
                if added.together(other, body):
                    builder.exclude(other, body)
    return added


def _check_patterns(field: str, patterns: Any, added: Added, prefix: str) -> None:
    """Each name or pattern, if these are what is given, fits a body."""
    from signorini._world import suggest

    names = [WORLD, *(body.removeprefix(prefix) for body in added.bodies)]
    for pattern in patterns if isinstance(patterns, (tuple, Mapping)) else ():
        if not any(fnmatchcase(name, pattern) for name in names):
            close = suggest(pattern, names)
            raise InvalidInputError(f"{field}: is {pattern!r}, no body of {added.file.name} is called so{close}")


def _named(path: Path, function: Callable[[], Result]) -> Result:
    """What the builder refuses, with the file."""
    try:
        return function()
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from None
