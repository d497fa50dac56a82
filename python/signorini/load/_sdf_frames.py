"""Frames of SDF files: models within models, names like a::b, poses relative to other frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from signorini.load._placement import Placement, from_quaternion, from_roll_pitch_yaw, identity
from signorini.load._xml import Element

Array = npt.NDArray[np.float64]
MAX_POSITION = 1e6  # [m]


@dataclass(eq=False)
class Frame:
    """A link, joint, model or plain frame.

    pose: in the frame `relative_to` of its scope. attached_to: the frame of its scope that it moves with; None: it is a
    link, or the world. place: in the world of the file.
    """

    element: Element
    scope: Scope
    pose: Placement
    relative_to: str
    attached_to: str | None
    inner: Scope | None = None  # whose own frame this is
    place: Placement | None = None

    @property
    def base(self) -> Frame:
        return self.scope.find(self.relative_to, self.element, "relative_to")


@dataclass(eq=False)
class Scope:
    """A model, or the world around all of them; path: prefix of the names in it; version: of its file."""

    path: str
    element: Element
    version: tuple[int, int]
    parent: Scope | None = None
    static: bool = False
    self_collide: bool = False
    placement_frame: str = ""
    canonical: str = ""
    own: Frame = field(init=False)
    frames: dict[str, Frame] = field(default_factory=dict)  # also of links and of models in it
    joints: dict[str, Frame] = field(default_factory=dict)
    scopes: dict[str, Scope] = field(default_factory=dict)

    @property
    def top(self) -> Scope:
        """The outermost model around it."""
        scope = self
        while scope.parent is not None and scope.parent.parent is not None:
            scope = scope.parent
        return scope

    def find(self, name: str, element: Element, field: str) -> Frame:
        """The frame that a name stands for; field: where the name is, for the error."""
        scope, last = self, name
        if name not in self.frames and name not in self.joints:
            *models, last = name.split("::")
            for model in models:
                if model not in scope.scopes:
                    element.fail(f'{field} is "{name}", there is no model "{model}"')
                scope = scope.scopes[model]
        if last == "__model__":
            return scope.own
        if last == "world" and not self.frames.get("world"):
            while scope.parent is not None:
                scope = scope.parent
            return scope.own
        found = scope.frames.get(last) or scope.joints.get(last)
        return found or element.fail(f'{field} is "{name}", there is no such frame')

    def add(self, frames: dict[str, Frame], frame: Frame, name: str = "") -> None:
        name = name or frame.element.string("name")
        if name == "world" or (name.startswith("__") and name.endswith("__")):
            frame.element.fail(f'name is "{name}", which has a meaning of its own')
        if name in frames:
            frame.element.fail(f"there is one of this name already, in line {frames[name].element.line}")
        frames[name] = frame


def place(frame: Frame) -> Placement:
    """Where a frame is in the world of the file."""
    chain: list[Frame] = []
    seen: set[Frame] = set()
    while frame.place is None:
        if frame in seen:
            frame.element.fail("its pose is relative to itself, by way of others")
        seen.add(frame)
        chain.append(frame)
        frame = frame.base
    result = frame.place
    for frame in reversed(chain):
        result = frame.place = result @ _local(frame)
    return result


def _local(frame: Frame) -> Placement:
    """The pose, of a model that says which frame in it has that pose: of the model."""
    scope = frame.inner
    if scope is None or not scope.placement_frame:
        return frame.pose
    within, seen = identity(), set()
    at = scope.find(scope.placement_frame, frame.element, "placement_frame")
    while at is not frame:
        if at in seen or at.place is not None:
            frame.element.fail(f'placement_frame is "{scope.placement_frame}", which is not placed in the model')
        seen.add(at)
        within, at = _local(at) @ within, at.base
    return frame.pose @ within.inverse()


def carrier(frame: Frame) -> Frame | None:
    """The link that a frame moves with; None: the world."""
    seen: set[Frame] = set()
    while True:
        if frame in seen:
            frame.element.fail("is attached to itself, by way of others")
        seen.add(frame)
        inner = frame.inner
        if inner is not None:
            if inner.parent is None or inner.static:
                return None
            if not inner.canonical:
                frame.element.fail("has no link that could carry its frame")
            frame = inner.find(inner.canonical, inner.element, "canonical_link")
        elif frame.attached_to is None:
            return frame
        else:
            frame = frame.scope.find(frame.attached_to, frame.element, "attached_to")


def pose(element: Element, default: str) -> tuple[Placement, str]:
    """<pose> of an element, and the frame that it is relative to."""
    child = element.find("pose")
    if child is None:
        return identity(), default
    child = child.flattened()
    relative_to = child.attributes.get("relative_to") or child.attributes.get("frame") or default
    form = child.attributes.get("rotation_format", "euler_rpy")
    if form == "quat_xyzw":
        values = child.vector("text", 7, (0.0,) * 6 + (1.0,), MAX_POSITION)
        length = float(np.linalg.norm(values[3:]))
        if length < 1e-6:
            child.fail(f'text is "{child.string("text")}", its quaternion must not be 0')
        return Placement(from_quaternion(values[3:] / length), values[:3]), relative_to
    if form != "euler_rpy":
        child.fail(f'rotation_format is "{form}", must be euler_rpy or quat_xyzw')
    values = child.vector("text", 6, (0.0,) * 6, MAX_POSITION)
    unit = math.pi / 180.0 if child.flag("degrees") else 1.0
    return Placement(from_roll_pitch_yaw(unit * values[3:]), values[:3]), relative_to
