"""One plain model for every engine: links, each on one joint, that the loaders of five engines can all take.

Dropped, since not all engines have them: limits, damping, dry friction, springs and armature of joints, actuators, all
of materials but one friction coefficient, the same for all pairs. Kept: masses, shapes, which pairs may touch, loops
closed point to point (rigid).
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from signorini._core import InvalidInputError
from signorini._world import (
    WORLD,
    Array,
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    Joint,
    Material,
    Shape,
    Sphere,
    World,
    WorldBuilder,
)

MODEL, MJCF, START = "model.json", "model.xml", "start.json"


def quaternion(rotation: Array) -> list[float]:
    """(x, y, z, w) of a 3 x 3 rotation, by the largest of its four ways."""
    r = rotation
    four = np.array([1 + r[0, 0] - r[1, 1] - r[2, 2], 1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2]])
    four = np.append(four, 1 + np.trace(r))
    k = int(np.argmax(four))
    rows = (
        (four[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]),
        (r[0, 1] + r[1, 0], four[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]),
        (r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], four[2], r[1, 0] - r[0, 1]),
        (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], four[3]),
    )
    q = np.array(rows[k])
    return [float(x) for x in q / np.linalg.norm(q)]


def _pose(rotation: Array, position: Array) -> dict[str, Any]:
    return {
        "position": np.asarray(position).tolist(),
        "rotation": np.asarray(rotation).tolist(),
        "quaternion": quaternion(np.asarray(rotation)),
    }


def plain(world: World, friction: float, restitution: float = 0.0) -> dict[str, Any]:
    """The model as numbers that JSON can hold; link k hangs on the world's joint k, in the frame of that joint.

    friction, restitution: of all pairs. Raises InvalidInputError for what it has no place for: height fields, welds and
    couplings, pairs of links of which some geometries may touch and others not.
    """
    if world._core.contact_pairs:
        raise InvalidInputError("world: has pairs with materials of their own, which the engines' model does not")
    links: list[dict[str, Any]] = []
    reached: dict[int, tuple[int, Array, Array]] = {}  # body -> frame so far, rotation and position of the body in it
    for joint in world.joints:
        body = world.bodies[joint.body]
        parent = world.bodies[body.parent]
        if joint.body in reached:
            frame, turn, at = reached[joint.body]
        else:
            frame = parent.frame
            turn = parent.in_frame.rotation @ body.placement.rotation
            at = parent.in_frame.rotation @ body.placement.translation + parent.in_frame.translation
        kind, anchor = joint.type.name, np.array(joint.anchor)
        if kind == "free" and (joint.armature > 0.0 or joint.friction > 0.0):
            raise InvalidInputError(f"joint {joint.name!r}: is free with armature or friction, has another place in q")
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        if kind in ("free", "prismatic"):
            anchor = np.zeros(3)
        position, rotation = at + turn @ anchor, np.array(turn)
        if kind == "free":
            position, rotation = np.zeros(3), np.eye(3)  # its q is the pose in the world
        elif kind == "revolute":
            rotation = rotation @ _turn(axis, -joint.reference)
        elif kind == "prismatic":
            position = position - joint.reference * (rotation @ axis)
        index = len(links) + 1
        links.append(
            {"name": joint.name, "parent": frame - 1, "type": kind, "axis": axis.tolist(), **_pose(rotation, position)}
        )
        reached[joint.body] = index, np.eye(3), -anchor
    for k, link in enumerate(links):
        link.update(_inertia(world, k + 1))
    geometries = [_geometry(world, k, friction) for k in range(len(world.geometries))]
    return {
        "gravity": world.gravity.tolist(),
        "friction": friction,
        "restitution": restitution,
        "links": links,
        "geometries": geometries,
        "excluded": _excluded(world, geometries),
        "loops": _loops(world),
    }


def _turn(axis: Array, angle: float) -> Array:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: Array = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return turn


def _inertia(world: World, frame: int) -> dict[str, Any]:
    """Mass, centre and inertia about it of all bodies fixed to a joint's frame."""
    mass, first, about_origin = 0.0, np.zeros(3), np.zeros((3, 3))
    for body in world.bodies[1:]:
        if body.frame == frame and body.mass > 0.0:
            turn = body.in_frame.rotation
            c = turn @ body.center + body.in_frame.translation
            mass += body.mass
            first += body.mass * c
            about_origin += turn @ body.inertia @ turn.T + body.mass * (c @ c * np.eye(3) - np.outer(c, c))
    center = first / mass if mass > 0.0 else np.zeros(3)
    inertia = about_origin - mass * (center @ center * np.eye(3) - np.outer(center, center))
    return {"mass": mass, "center": center.tolist(), "inertia": (0.5 * (inertia + inertia.T)).tolist()}


def _geometry(world: World, index: int, friction: float) -> dict[str, Any]:
    geometry = world.geometries[index]
    body = world.bodies[geometry.body]
    shape = geometry.shape
    kind = shape.type.name
    if kind == "height_field":
        raise InvalidInputError(
            f"geometry {geometry.name!r}: is a height field, which the engines' model does not have"
        )
    rotation = body.in_frame.rotation @ geometry.placement.rotation
    position = body.in_frame.rotation @ geometry.placement.translation + body.in_frame.translation
    out: dict[str, Any] = {"link": body.frame - 1, "shape": kind, "size": shape.size.tolist()}
    if kind == "convex":
        out |= {"vertices": shape.vertices.tolist(), "triangles": shape.triangles.tolist(), "mesh": f"hull-{index}.obj"}
    return {**out, "friction": friction, **_pose(rotation, position)}


def _excluded(world: World, geometries: list[dict[str, Any]]) -> list[list[int]]:
    """Pairs of links that never touch, -1 for the world; links without geometry are left out."""
    of: dict[int, list[int]] = {}
    for k, geometry in enumerate(geometries):
        of.setdefault(geometry["link"], []).append(k)
    pairs = []
    order = sorted(of)
    for n, a in enumerate(order):
        for b in order[n + 1 :]:
            some = {world._core.may_touch(i, j) for i in of[a] for j in of[b]}
            if some == {True, False}:
                raise InvalidInputError(f"links {a} and {b}: some of their geometries may touch and others not")
            if some == {False}:
                pairs.append([a, b])
    return pairs


def _loops(world: World) -> list[dict[str, Any]]:
    loops = []
    for constraint in world.constraints:
        if constraint.type.name != "connect":
            raise InvalidInputError(f"constraint {constraint.name!r}: is a {constraint.type.name}, must be a connect")
        ends: dict[str, Any] = {}
        for side in ("a", "b"):
            body = world.bodies[getattr(constraint, f"body_{side}")]
            point = getattr(constraint, f"placement_{side}").translation
            ends[f"link_{side}"] = body.frame - 1
            ends[f"point_{side}"] = (body.in_frame.rotation @ point + body.in_frame.translation).tolist()
        loops.append(ends)
    return loops


def build(model: dict[str, Any]) -> World:
    """Ours of a plain model: same q and v, bodies called as their joints."""
    builder = WorldBuilder(model["gravity"])
    names = [link["name"] for link in model["links"]]
    for link in model["links"]:
        builder.add_body(
            link["name"],
            parent=names[link["parent"]] if link["parent"] >= 0 else WORLD,
            position=link["position"],
            orientation=np.array(link["rotation"]),
            joints=[Joint(link["name"], link["type"], axis=link["axis"])],
            mass=link["mass"],
            center=link["center"],
            inertia=link["inertia"],
        )
    for k, geometry in enumerate(model["geometries"]):
        builder.add_geometry(
            names[geometry["link"]] if geometry["link"] >= 0 else WORLD,
            _shape(geometry),
            position=geometry["position"],
            orientation=np.array(geometry["rotation"]),
            material=Material(friction=geometry["friction"], restitution=model["restitution"]),
            name=f"geometry-{k}",
        )
    for a, b in model["excluded"]:
        builder.exclude(*(names[k] if k >= 0 else WORLD for k in (a, b)))
    for loop in model["loops"]:
        a, b = (names[loop[key]] if loop[key] >= 0 else WORLD for key in ("link_a", "link_b"))
        builder.add_connect(a, b, loop["point_a"], loop["point_b"])
    return builder.build()


def _shape(geometry: dict[str, Any]) -> Shape:
    x, y, z = geometry["size"]
    match geometry["shape"]:
        case "sphere":
            return Sphere(x)
        case "box":
            return Box((x, y, z))
        case "capsule":
            return Capsule(x, y)
        case "cylinder":
            return Cylinder(x, y)
        case "ellipsoid":
            return Ellipsoid((x, y, z))
        case "half_space":
            return HalfSpace()
    return Convex(np.array(geometry["vertices"]), np.array(geometry["triangles"], dtype=np.int32))


def write(model: dict[str, Any], q: Array, folder: Path) -> None:
    """model.json, start.json, an OBJ file a hull and model.xml, MuJoCo's."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MODEL).write_text(json.dumps(model))
    (folder / START).write_text(json.dumps({"q": list(map(float, q))}))
    for geometry in model["geometries"]:
        if geometry["shape"] == "convex":
            lines = ["v " + _numbers(vertex) for vertex in geometry["vertices"]]
            lines += ["f " + " ".join(str(k + 1) for k in triangle) for triangle in geometry["triangles"]]
            (folder / geometry["mesh"]).write_text("\n".join(lines) + "\n")
    (folder / MJCF).write_text(mjcf(model))


def _numbers(values: Any) -> str:
    return " ".join(f"{float(x):.17g}" for x in values)


def _place(pose: dict[str, Any]) -> str:
    x, y, z, w = pose["quaternion"]
    return f'pos="{_numbers(pose["position"])}" quat="{_numbers((w, x, y, z))}"'


def mjcf(model: dict[str, Any]) -> str:
    """MuJoCo's XML of a plain model; links without mass become joints of the body that they carry."""
    links, geometries = model["links"], model["geometries"]
    children: dict[int, list[int]] = {}
    for k, link in enumerate(links):
        children.setdefault(link["parent"], []).append(k)
    meshes = "".join(
        f'<mesh name="hull-{k}" inertia="convex" vertex="{_numbers(np.ravel(geometry["vertices"]))}"/>'
        for k, geometry in enumerate(geometries)
        if geometry["shape"] == "convex"
    )

    def bodies(parent: int) -> str:
        return "".join(body([k]) for k in children.get(parent, []))

    def body(chain: list[int]) -> str:
        link = links[chain[-1]]
        if link["mass"] == 0.0:
            if len(children.get(chain[-1], [])) != 1:
                raise InvalidInputError(f"link {link['name']!r}: has no mass and does not carry exactly one link")
            return body([*chain, children[chain[-1]][0]])
        turn, at = np.eye(3), np.zeros(3)  # of the link in the body, joints at 0
        joints = []
        for k in reversed(chain):
            part = links[k]
            kind = {"free": "free", "ball": "ball", "revolute": "hinge", "prismatic": "slide"}[part["type"]]
            place = "" if kind == "free" else f' pos="{_numbers(at)}"'
            place += f' axis="{_numbers(turn @ part["axis"])}"' if kind in ("hinge", "slide") else ""
            joints.append(f'<joint name="{part["name"]}" type="{kind}"{place}/>')
            rotation, position = np.array(part["rotation"]), np.array(part["position"])
            at, turn = at - turn @ rotation.T @ position, turn @ rotation.T
        root = _pose(turn.T, -turn.T @ at)
        i = np.array(link["inertia"])
        six = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        inertia = (
            f'<inertial pos="{_numbers(link["center"])}" mass="{link["mass"]:.17g}" fullinertia="{_numbers(six)}"/>'
        )
        inside = "".join(reversed(joints)) + inertia + geoms(chain[-1]) + bodies(chain[-1])
        return f'<body name="{link["name"]}" {_place(root)}>{inside}</body>'

    def geoms(link: int) -> str:
        return "".join(_mjcf_geom(k, geometry) for k, geometry in enumerate(geometries) if geometry["link"] == link)

    names = [link["name"] for link in links] + ["world"]  # -1 is the world
    excludes = "".join(f'<exclude body1="{names[a]}" body2="{names[b]}"/>' for a, b in model["excluded"])
    connects = "".join(
        f'<connect site1="loop-{n}-a" site2="loop-{n}-b"/>' for n in range(len(model["loops"]))
    )  # sites: both ends as they are given, wherever the model stands when it is compiled
    text = (
        '<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option gravity="{_numbers(model["gravity"])}"><flag filterparent="disable"/></option>'
        f"<asset>{meshes}</asset><worldbody>{geoms(-1)}{bodies(-1)}</worldbody>"
        f"<contact>{excludes}</contact><equality>{connects}</equality></mujoco>"
    )
    for n, loop in enumerate(model["loops"]):
        for side in ("a", "b"):
            head = f'<body name="{names[loop[f"link_{side}"]]}"'
            start = text.index(">", text.index(head)) + 1
            site = f'<site name="loop-{n}-{side}" pos="{_numbers(loop[f"point_{side}"])}"/>'
            text = text[:start] + site + text[start:]
    return text


def _mjcf_geom(index: int, geometry: dict[str, Any]) -> str:
    kind, size = geometry["shape"], geometry["size"]
    sizes = {"sphere": size[:1], "box": size, "capsule": size[:2], "cylinder": size[:2], "ellipsoid": size}
    if kind == "convex":
        what = f'type="mesh" mesh="hull-{index}"'
    elif kind == "half_space":
        what = 'type="plane" size="10 10 1"'
    else:
        what = f'type="{kind}" size="{_numbers(sizes[kind])}"'
    return f'<geom {what} {_place(geometry)} friction="{geometry["friction"]:g} 0.005 0.0001"/>'
