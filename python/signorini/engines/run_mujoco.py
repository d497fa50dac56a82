"""MuJoCo: Newton's method, one thread, in the settings pyramidal, elliptic and accurate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import _mujoco_settings
import _worker
import mujoco
import numpy as np


class Engine:
    """The MJCF file of the model; q and v differ from ours in the order of quaternions and the frame of free joints."""

    def __init__(self, folder: Path, model: dict[str, Any], setting: str, time_step: float) -> None:
        if model["restitution"] > 0.0:
            raise ValueError(_worker.NO_RESTITUTION)
        self.model = mujoco.MjModel.from_xml_string((folder / "model.xml").read_text())
        _mujoco_settings.apply(self.model, setting, time_step)
        self.links, self.layout = model["links"], _worker.layout(model)
        self.data = mujoco.MjData(self.model)
        numbers = {link["name"]: k for k, link in enumerate(self.links)}
        self.link_of = [-1] + [numbers[self.model.body(k).name] for k in range(1, self.model.nbody)]

    def _quaternions(self, q: Any, shift: int) -> Any:
        out = np.array(q)
        for link, (first, _, _, _) in zip(self.links, self.layout, strict=True):
            if link["type"] in ("free", "ball"):
                at = first + (3 if link["type"] == "free" else 0)
                out[at : at + 4] = np.roll(out[at : at + 4], shift)
        return out

    def set_state(self, q: Any) -> None:
        self.data.qpos[:] = self._quaternions(q, 1)
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def state(self) -> tuple[Any, Any]:
        q, v = self._quaternions(self.data.qpos, -1), np.array(self.data.qvel)
        for link, (first, _, at, _) in zip(self.links, self.layout, strict=True):
            if link["type"] == "free":
                v[at : at + 3] = _worker.rotation(q[first + 3 : first + 7]).T @ v[at : at + 3]
        return q, v

    def step(self, count: int) -> None:
        mujoco.mj_step(self.model, self.data, nstep=count)

    def mass_matrix(self) -> Any:
        full = np.zeros((self.model.nv, self.model.nv))
        try:
            mujoco.mj_fullM(self.model, self.data, full)
        except TypeError:  # before 3.4
            mujoco.mj_fullM(self.model, full, self.data.qM)
        return full

    def total_mass(self) -> float:
        return float(self.model.body_mass.sum())

    def report(self) -> dict[str, Any]:
        m = self.model
        links: list[Any] = [None] * len(self.links)
        for body in range(1, m.nbody):
            links[self.link_of[body]] = [float(m.body_mass[body]), *sorted(map(float, m.body_inertia[body]))]
        return {
            "time_step": float(m.opt.timestep),
            "gravity": m.opt.gravity.tolist(),
            "links": links,
            "limits": int(m.jnt_limited.sum()),
            "damping": float(m.dof_damping.max(initial=0.0) + m.dof_frictionloss.max(initial=0.0)),
            "pairs": self._pairs(),
        }

    def _pairs(self) -> list[list[int]]:
        """Of bodies, as its broad phase decides: masks, one rigid body, excluded ones."""
        m = self.model
        if not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
            raise ValueError("leaves out parent and child by itself")
        found = set()
        for a in range(m.ngeom):
            for b in range(a):
                masks = m.geom_contype[a] & m.geom_conaffinity[b] or m.geom_contype[b] & m.geom_conaffinity[a]
                one, other = sorted((int(m.geom_bodyid[a]), int(m.geom_bodyid[b])))
                apart = m.body_weldid[one] != m.body_weldid[other] and (one << 16) + other not in m.exclude_signature
                if masks and apart:
                    found.add(tuple(sorted((self.link_of[one], self.link_of[other]))))
        return [list(pair) for pair in sorted(found)]

    def touching(self) -> list[Any]:
        bodies = self.model.geom_bodyid[self.data.contact.geom[: self.data.ncon]]
        return [[self.link_of[a], self.link_of[b]] for a, b in bodies]

    def extra(self) -> dict[str, float]:
        return {}


if __name__ == "__main__":
    _worker.main(mujoco.__version__, Engine)
