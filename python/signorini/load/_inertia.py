"""Masses and inertias: which a body can have, how they add up, how they are mended."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from signorini.load._options import Warnings
from signorini.load._placement import Placement, identity
from signorini.load._xml import Element

Array = npt.NDArray[np.float64]


class Inertia(NamedTuple):
    """mass [kg], centre of mass [m], inertia about it, axes of the body [kg m^2]."""

    mass: float
    center: Array
    inertia: Array

    def placed(self, placement: Placement) -> Inertia:
        """The same in the frame that `placement` leads to."""
        rotation = placement.rotation
        return Inertia(
            self.mass,
            rotation @ self.center + placement.position,
            rotation @ self.inertia @ rotation.T,
        )


def nothing() -> Inertia:
    return Inertia(0.0, np.zeros(3), np.zeros((3, 3)))


def fault(value: Inertia) -> str | None:
    """Why no body can have this, in the words of the builder; None when one can."""
    from signorini import _simulator

    return _simulator.inertia_fault(value.mass, value.inertia) or None


def rounded(value: Inertia) -> Inertia:
    """The same without principal moments that are negative by rounding."""
    moments, axes = np.linalg.eigh(value.inertia)
    if moments[0] >= 0.0:
        return value
    return Inertia(value.mass, value.center, axes @ np.diag(np.maximum(moments, 0.0)) @ axes.T)


def added(parts: list[Inertia]) -> Inertia:
    """The inertia of several bodies tied together, all in one frame."""
    mass = sum(part.mass for part in parts)
    if mass == 0.0:
        return Inertia(0.0, np.zeros(3), np.sum([part.inertia for part in parts], axis=0))
    center = np.sum([part.mass * part.center for part in parts], axis=0) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        r = part.center - center
        inertia += part.inertia + part.mass * (r @ r * np.eye(3) - np.outer(r, r))
    return Inertia(mass, center, inertia)


def mended(value: Inertia) -> Inertia:
    """The nearest inertia in the sense that negative moments are set to 1e-3 of the largest, and the two smaller ones
    raised by the same amount until the triangle inequality holds."""
    if value.mass == 0.0:
        return nothing()
    moments, axes = np.linalg.eigh(value.inertia)
    moments = np.maximum(moments, 1e-3 * moments[2])
    moments[:2] += max(0.0, 0.5 * (moments[2] - moments[0] - moments[1]))
    return Inertia(value.mass, value.center, axes @ np.diag(moments) @ axes.T)


class Part(NamedTuple):
    """A link: what it is fixed to, by name, and its placement there; None: it moves, or hangs on the world."""

    name: str
    inertia: Inertia
    element: Element
    fixed_to: str | None
    placement: Placement


def possible(
    parts: Iterable[Part], anchored: Collection[str], repair: bool, warnings: Warnings, mended_names: list[str]
) -> dict[str, Inertia]:
    """By name, each one that a body can have. A link that could not be a body by itself is counted in the link that it
    is fixed to, when their sum can be one; else it is mended or refused.

    parts: what others are fixed to comes first. anchored: names of those fixed to the world, where inertias have no
    effect. mended_names: those mended are added to it.
    """
    result: dict[str, Inertia] = {}
    head: dict[str, str] = {}  # the link that this one is fixed to, directly or by others
    placement: dict[str, Placement] = {}  # in it
    groups: dict[str, list[Part]] = {}
    for part in parts:
        result[part.name] = part.inertia
        if part.fixed_to is None:
            head[part.name], placement[part.name] = part.name, identity()
        else:
            head[part.name] = head[part.fixed_to]
            placement[part.name] = placement[part.fixed_to] @ part.placement
        groups.setdefault(head[part.name], []).append(part)
    for name, group in groups.items():
        faults = {part.name: fault(part.inertia) for part in group}
        bad = [part for part in group if faults[part.name]]
        if not bad:
            continue
        total = added([part.inertia.placed(placement[part.name]) for part in group])
        if name not in anchored and (fault(total) or total.mass == 0.0) and not repair:
            inertial = bad[0].element.need("inertial")
            inertial.fail(f"{faults[bad[0].name]}; repair_inertia=True mends this")
        if name in anchored or fault(total):
            for part in bad:
                result[part.name] = mended(part.inertia)
            names = [part.name for part in bad]
            if name in anchored:
                reason = "inertias that no body can have are mended, of what is fixed to the world"
                warnings.add(reason, *names)
            else:
                warnings.add("inertias that no body can have are mended", *names)
                mended_names += names
        else:
            for part in group:
                result[part.name] = nothing()
            result[name] = total
            reason = "links whose inertia no body can have are counted in those that they are fixed to"
            warnings.add(reason, *(part.name for part in bad))
    return {name: rounded(inertia) for name, inertia in result.items()}
