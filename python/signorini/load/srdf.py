"""SRDF, the file beside a URDF: named configurations and pairs of links that never touch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini.load import _xml

if TYPE_CHECKING:
    from signorini._world import World

Array = npt.NDArray[np.float64]


@dataclass
class Srdf:
    """states: by name the values of joints by name, each (n,) [rad, m]; of several groups the union.
    disabled: pairs of links that never touch."""

    states: dict[str, dict[str, Array]] = field(default_factory=dict)
    disabled: list[tuple[str, str]] = field(default_factory=list)


def read(path: Path) -> Srdf:
    """Raises InvalidInputError: file, line, element, attribute, value."""
    root = _xml.parse(path)
    if root.tag != "robot":
        root.fail("is no SRDF: its root must be <robot>")
    result = Srdf()
    for element in root:
        if element.tag == "group_state":
            state = result.states.setdefault(element.string("name"), {})
            for joint in element.all("joint"):
                size = len(joint.string("value").split())
                state[joint.string("name")] = joint.vector("value", size)
        elif element.tag == "disable_collisions":
            result.disabled.append((element.string("link1"), element.string("link2")))
    return result


def configuration(world: World, state: dict[str, Array], prefix: str = "") -> Array:
    """initial_q with the values of the joints that a state names; joints that the world has not are left out."""
    q = world.initial_q
    for name, value in state.items():
        if prefix + name in world.joint_names:
            part = world.q_slice(prefix + name)
            if len(value) != part.stop - part.start:
                raise InvalidInputError(
                    f'state: joint "{name}" has {len(value)} values, must have {part.stop - part.start}'
                )
            q[part] = value
    return q
