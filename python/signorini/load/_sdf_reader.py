"""SDF files and what they include -> links and joints, checked. The rules: docs/robot_files.md."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from signorini.load import _sdf_frames, _xml, urdf
from signorini.load._files import FileFinder, PathLike
from signorini.load._inertia import Inertia
from signorini.load._options import Warnings
from signorini.load._placement import identity
from signorini.load._sdf_frames import Frame, Scope
from signorini.load._sdf_parts import AXES, Axis, Link, SdfJoint, collision, flag, leaf, leaves, text
from signorini.load._xml import Element

Array = npt.NDArray[np.float64]

WORLD = "world"
VERSIONS = ((1, 4), (1, 12))
MAX_NESTING = 40  # models within models, included or not
INFINITE = 1e16
#: By element, what is read in it, or says nothing here.
_READ = {
    "world": {"gravity", "model", "include", "joint", "frame", "wind"},
    "model": {"pose", "link", "joint", "frame", "model", "include", "static", "self_collide", "enable_wind"},
    "link": {"pose", "inertial", "collision", "visual", "gravity", "self_collide", "velocity_decay", "kinematic"}
    | {"enable_wind"},
    "joint": {"pose", "parent", "child", "axis", "axis2", "physics", "thread_pitch", "screw_thread_pitch"},
    "axis": {"xyz", "limit", "dynamics", "mimic", "use_parent_model_frame"},
    "collision": {"pose", "geometry", "surface", "laser_retro", "max_contacts", "density", "auto_inertia_params"},
    "inertial": {"pose", "mass", "inertia", "density", "auto_inertia_params"},
}
_STRUCTURE = {*_READ, *("inertial", "mass", "inertia", "collision", "geometry", "axis", "limit", "dynamics", "surface")}
_NO_PHYSICS = {
    *("light", "sensor", "scene", "gui", "audio", "physics", "spherical_coordinates", "atmosphere", "magnetic_field"),
    *("projector", "audio_sink", "audio_source", "particle_emitter", "battery", "allow_auto_disable"),
    *("must_be_base_link", "visual"),
}
_SURFACE_READ = {
    *("friction/ode/mu", "bounce/restitution_coefficient", "contact/collide_bitmask", "contact/category_bitmask"),
    *("friction/ode/mu2", "contact/poissons_ratio", "contact/ode", "contact", "friction", "friction/ode", "bounce"),
}


class Reader:
    """Reads one file: read(), then links, joints, scopes and gravity are there."""

    def __init__(self, path: Path, package_dirs: Iterable[PathLike]) -> None:
        self.warnings = Warnings(path)
        self.name = path.stem
        self.gravity: tuple[float, float, float] | None = None
        self.scopes: list[Scope] = []
        self._path = path
        self._finder = FileFinder(path, package_dirs)
        self._files: dict[Path, tuple[Element, tuple[int, int], int]] = {}
        self._num_elements = 0
        self._open: list[Path] = []  # files that include each other
        self._version = VERSIONS[0]  # of the last of them
        self._links: dict[Frame, Link] = {}
        self._joints: dict[Frame, SdfJoint] = {}

    @property
    def links(self) -> list[Link]:
        return list(self._links.values())

    @property
    def joints(self) -> list[SdfJoint]:
        return list(self._joints.values())

    def read(self) -> None:
        root, self._version = self._file(self._path)
        found = [child for child in root if child.tag in ("world", "model")]
        if not found:
            root.fail("has neither <model> nor <world>")
        if len(found) > 1:
            found[1].fail("is the second <model> or <world> of the file, one is allowed")
        top = found[0]
        self.name = top.attributes.get("name", self.name)
        around = Scope("", top if top.tag == "world" else root, self._version)
        around.own = Frame(root, around, identity(), "", None, around, identity())
        self._open.append(self._path.resolve())
        self.scopes.append(around)
        if top.tag == "world":
            self._world(top, around)
        else:
            self._model(top, around, "")
        if not self._links:
            top.fail("has no <link>")
        for frame, link in self._links.items():
            link.place = _sdf_frames.place(frame)
            for element in link.element.all("collision"):
                link.collisions.append(self._collision(element, link))
        for scope in self.scopes:
            for name, frame in scope.joints.items():
                self._joints[frame] = self._joint(frame, scope.path + name)
        for frame, joint in self._joints.items():
            for axis, tag in zip(joint.axes, AXES[joint.type], strict=False):
                mimic = frame.element.need(tag).find("mimic")
                if mimic is not None:
                    self._mimic(mimic, axis, frame.scope)

    def _file(self, path: Path) -> tuple[Element, tuple[int, int]]:
        if path not in self._files:
            root = _xml.parse(path)
            if root.tag != "sdf":
                root.fail("is no SDF: its root must be <sdf>")
            found = re.fullmatch(r"\s*([0-9]{1,3})\.([0-9]{1,3})\s*", root.string("version"))
            version = (0, 0) if found is None else (int(found[1]), int(found[2]))
            if not VERSIONS[0] <= version <= VERSIONS[1]:
                root.fail(f'version is "{root.string("version")}", must be 1.4 to 1.12')
            self._files[path] = root, version, _size(root)
        root, version, size = self._files[path]
        self._num_elements += size
        if self._num_elements > _xml.MAX_ELEMENTS:
            root.fail(f"with all that is included there are more than {_xml.MAX_ELEMENTS} elements")
        return root, version

    def _look(self, element: Element, name: str) -> None:
        """At what is in an element and not read."""
        read = _READ[element.tag.removesuffix("2")]
        for child in element:
            if child.tag in read or child.tag.startswith("experimental:"):
                continue
            if child.tag in _STRUCTURE:
                child.fail(f"does not belong in <{element.tag}>")
            if child.tag not in _NO_PHYSICS:
                self.warnings.add(f"<{child.tag}> of <{element.tag}> is not read", child.attributes.get("name") or name)
        for tag in ("enable_wind", "kinematic"):
            if tag in read and flag(element, tag):
                self.warnings.add(f"<{tag}> is not read", name)

    # Models

    def _world(self, element: Element, around: Scope) -> None:
        self._look(element, self.name)
        if leaf(element, "wind").vector("linear_velocity", 3, (0.0, 0.0, 0.0)).any():
            self.warnings.add("<wind> is not read: the air does not move")
        self._children(element, around)
        x, y, z = leaf(element, "gravity").vector("text", 3, (0.0, 0.0, -9.8), 1e6)
        self.gravity = float(x), float(y), float(z)

    def _model(self, element: Element, around: Scope, path: str, include: Element | None = None) -> None:
        """path: prefix of the names in it. include: what brought it here, and goes before what it says itself."""
        given = include if include is not None else Element("include", {}, element.line, element.file)
        name = path.removesuffix("::").removeprefix(around.path) or element.string("name")
        depth, above = 0, around
        while above.parent is not None:
            depth, above = depth + 1, above.parent
        if depth >= MAX_NESTING:
            element.fail(f"is nested more than {MAX_NESTING} models deep")
        scope = Scope(path, element, self._version, around)
        scope.static = around.static or flag(element, "static") or flag(given, "static")
        scope.self_collide = flag(element, "self_collide")
        posed = element if given.find("pose") is None else given
        inner = element.attributes.get("placement_frame", "")
        scope.placement_frame = leaf(given, "placement_frame").attributes.get("text", inner)
        pose, relative_to = _sdf_frames.pose(posed, "__model__")
        scope.own = Frame(element if include is None else include, around, pose, relative_to, None, scope)
        around.add(around.frames, scope.own, name)
        around.scopes[name] = scope
        self.scopes.append(scope)
        self._look(element, name)
        self._children(element, scope)
        first = [link.string("name") for link in element.all("link")] + list(scope.scopes)
        scope.canonical = element.attributes.get("canonical_link") or next(iter(first), "")

    def _children(self, element: Element, scope: Scope) -> None:
        for child in element:
            if child.tag == "link":
                self._link(child, scope)
            elif child.tag == "joint":
                if child.string("type") == "gearbox":
                    self.warnings.add("joints of type gearbox are not carried over", child.string("name"))
                    continue
                moved = text(child, "child")
                scope.add(scope.joints, Frame(child, scope, *_sdf_frames.pose(child, moved), moved))
            elif child.tag == "frame":
                attached = child.attributes.get("attached_to") or "__model__"
                scope.add(scope.frames, Frame(child, scope, *_sdf_frames.pose(child, attached), attached))
            elif child.tag == "model":
                self._model(child, scope, f"{scope.path}{child.string('name')}::")
            elif child.tag == "include":
                self._include(child, scope)

    def _include(self, element: Element, scope: Scope) -> None:
        if element.flag("merge"):
            element.fail("merge is true, which is not read")
        path = self._finder.find_model(element, text(element, "uri")).resolve()
        if path in self._open:
            element.fail(f"{path} is included by itself")
        root, version = self._file(path)
        models = root.all("model")
        if not models and root.find("light") is not None:
            return
        if len(models) != 1:
            element.fail(f"{path} has {len(models)} models, must have one")
        name = models[0].string("name") if element.find("name") is None else text(element, "name")
        for plugin in element.all("plugin"):
            self.warnings.add("<plugin> of <model> is not read", plugin.attributes.get("name") or name)
        before, self._version = self._version, version
        self._open.append(path)
        self._model(models[0], scope, f"{scope.path}{name}::", element)
        self._open.pop()
        self._version = before

    # Links

    def _link(self, element: Element, scope: Scope) -> None:
        frame = Frame(element, scope, *_sdf_frames.pose(element, "__model__"), None)
        scope.add(scope.frames, frame)
        name = scope.path + element.string("name")
        self._look(element, name)
        if not flag(element, "gravity", True):
            self.warnings.add("links without gravity have it here", name)
        decay = leaf(element, "velocity_decay")
        if decay.number("linear", 0.0) or decay.number("angular", 0.0):
            self.warnings.add("<velocity_decay> of <link> is not read", name)
        link = Link(name, element, self._inertial(element, name), [], scope=scope)
        link.self_collide = scope.self_collide or flag(element, "self_collide")
        self._links[frame] = link

    def _inertial(self, link: Element, name: str) -> Inertia:
        """Mass 1 and inertia 1 where nothing is given, as the format says."""
        element = leaf(link, "inertial")
        if element.flag("auto"):
            element.fail("auto is true: inertias are not computed from shapes; write mass and inertia")
        if element.children:
            self._look(element, name)
        mass, entries = element.number("mass", 1.0, 0.0, urdf.MAX_MASS), leaf(element, "inertia")
        xx, yy, zz = (entries.number(key, 1.0, -urdf.MAX_INERTIA, urdf.MAX_INERTIA) for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (entries.number(key, 0.0, -urdf.MAX_INERTIA, urdf.MAX_INERTIA) for key in ("ixy", "ixz", "iyz"))
        about_center = Inertia(mass, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        return about_center.placed(_sdf_frames.pose(element, "")[0])

    def _collision(self, element: Element, link: Link) -> urdf.Collision:
        self._look(element, link.name)
        surface = element.find("surface")
        for inner in leaves(surface):
            if inner not in _SURFACE_READ:
                self.warnings.add(f"contacts are rigid, friction one coefficient; <{inner}> is not read", link.name)
        ode = leaf(leaf(leaf(element, "surface"), "friction"), "ode")
        if ode.number("mu2", ode.number("mu", 1.0)) != ode.number("mu", 1.0):
            self.warnings.add("friction is the same in all directions: <mu>, not <mu2>", link.name)
        result = collision(element, link)
        if any(child.tag == "submesh" for child in result.geometry):
            self.warnings.add("<submesh> is not read: the whole mesh collides", link.name)
        return result

    # Joints

    def _joint(self, frame: Frame, name: str) -> SdfJoint:
        element, scope = frame.element, frame.scope
        kind = element.string("type")
        if kind not in AXES:
            element.fail(f'type is "{kind}", must be one of {", ".join(AXES)}')
        self._look(element, name)
        parent, child = (self._end(element.need(role), scope) for role in ("parent", "child"))
        if child is None:
            element.need("child").fail("is the world, or a model that is static; it must be able to move")
        if parent is child:
            element.fail(f'parent and child are both "{child.name}"')
        joint = SdfJoint(name, kind, parent, child, _sdf_frames.place(frame), element)
        joint.axes = [self._axis(element.need(tag), joint, scope) for tag in AXES[kind]]
        if len(joint.axes) == 2:
            joint.axes[0].name, joint.axes[1].name = f"{name}_1", f"{name}_2"
        for tag in ("axis", "axis2"):
            if tag not in AXES[kind] and element.find(tag) is not None:
                self.warnings.add(f"<{tag}> of {kind} joints is not read", name)
        if kind == "screw":
            joint.axes.append(self._slide(joint))
        physics = element.find("physics")
        joint.cut = flag(leaf(leaf(element, "physics"), "simbody"), "must_be_loop_joint")
        for inner in leaves(physics):
            if not inner.endswith(("must_be_loop_joint", "provide_feedback", "ode", "simbody")):
                self.warnings.add(f"joints are rigid; <{inner}> is not read", name)
        return joint

    def _end(self, element: Element, scope: Scope) -> Link | None:
        """A parent or child; None: the world."""
        carrier = _sdf_frames.carrier(scope.find(element.flattened().string("text"), element, element.tag))
        return None if carrier is None else self._links[carrier]

    def _axis(self, element: Element, joint: SdfJoint, scope: Scope) -> Axis:
        self._look(element, joint.name)
        xyz = leaf(element, "xyz")
        direction = xyz.vector("text", 3, (0.0, 0.0, 1.0), 1e6)
        length = float(np.linalg.norm(direction))
        if length < 1e-6:
            xyz.fail(f'text is "{xyz.string("text")}", must not be 0')
        rotation = joint.place.rotation
        if scope.version <= (1, 4) or (scope.version <= (1, 6) and flag(element, "use_parent_model_frame")):
            rotation = _sdf_frames.place(scope.own).rotation
        elif xyz.attributes.get("expressed_in"):
            named = scope.find(xyz.string("expressed_in"), xyz, "expressed_in")
            rotation = _sdf_frames.place(named).rotation
        kind = "prismatic" if joint.type == "prismatic" else "revolute"
        axis = Axis(joint.name, kind, rotation @ direction / length, element)
        self._limit(leaf(element, "limit"), axis, joint)
        dynamics = leaf(element, "dynamics")
        axis.damping = dynamics.number("damping", 0.0, 0.0)
        axis.friction = dynamics.number("friction", 0.0, 0.0)
        axis.stiffness = dynamics.number("spring_stiffness", 0.0, 0.0)
        axis.spring_reference = dynamics.number("spring_reference", 0.0) if axis.stiffness else 0.0
        return axis

    def _limit(self, limit: Element, axis: Axis, joint: SdfJoint) -> None:
        lower, upper = limit.number("lower", -math.inf, infinite=True), limit.number("upper", math.inf, infinite=True)
        if lower > upper:
            limit.fail(f"lower is {lower:g} and upper {upper:g}, lower must not exceed upper")
        if joint.type != "continuous":
            axis.lower = lower if lower > -INFINITE else -math.inf
            axis.upper = upper if upper < INFINITE else math.inf
        effort = limit.number("effort", -1.0, infinite=True)
        axis.effort = effort if 0.0 <= effort < INFINITE else math.inf
        if 0.0 <= limit.number("velocity", -1.0, infinite=True) < INFINITE:
            self.warnings.add("velocity limits are not kept", joint.name)
        if "stiffness" in limit.attributes or "dissipation" in limit.attributes:
            self.warnings.add("limits are rigid; <stiffness> and <dissipation> are not read", joint.name)

    def _slide(self, joint: SdfJoint) -> Axis:
        """Of a screw, bound to its turn."""
        values = joint.element.flattened()
        if "thread_pitch" in values.attributes and "screw_thread_pitch" not in values.attributes:
            pitch = values.number("thread_pitch")  # [rad/m], of a left-handed thread
            if abs(pitch) < 1e-9:
                values.fail(f'thread_pitch is "{values.string("thread_pitch")}", must not be 0')
            slope = -1.0 / pitch
        else:
            slope = values.number("screw_thread_pitch", 1.0) / (2.0 * math.pi)
        turn = joint.axes[0]
        slide = Axis(f"{joint.name}_slide", "prismatic", turn.direction, joint.element)
        slide.coupling = turn, slope, 0.0, 0.0
        return slide

    def _mimic(self, mimic: Element, axis: Axis, scope: Scope) -> None:
        name, which = mimic.string("joint"), mimic.attributes.get("axis") or "axis"
        driver = self._joints.get(scope.find(name, mimic, "joint"))
        if driver is None or which not in AXES[driver.type]:
            mimic.fail(f'joint is "{name}", there is no joint of that name with <{which}>')
        values = mimic.flattened()
        leader = driver.axes[AXES[driver.type].index(which)]
        multiplier, offset = values.number("multiplier", 1.0), values.number("offset", 0.0)
        axis.coupling = leader, multiplier, offset, values.number("reference", 0.0)
        at = leader
        while at is not axis and at.coupling is not None:
            at = at.coupling[0]
        if at is axis:
            mimic.fail(f'joint "{name}" mimics, in turn, this one')


def _size(root: Element) -> int:
    count, stack = 0, [root]
    while stack:
        stack.extend(stack.pop().children)
        count += 1
    return count
