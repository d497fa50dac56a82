"""MuJoCo: Newton's method, one thread, in the settings pyramidal, elliptic and accurate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import _worker
import mujoco
import numpy as np


class Engine:
    """The MJCF file of the model; q and v differ from ours in the order of quaternions and the frame of free joints."""

    def __init__(self, folder: Path, model: dict[str, Any], setting: str, time_step: float) -> None:
        self.model = mujoco.MjModel.from_xml_string((folder / "model.xml").read_text())
        self.model.opt.timestep = time_step
        self.links, self.layout = model["links"], _worker.layout(model)
        self._set(setting, time_step)
        self.data = mujoco.MjData(self.model)

    def _set(self, setting: str, time_step: float) -> None:
        option = self.model.opt
        option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL if setting == "pyramidal" else mujoco.mjtCone.mjCONE_ELLIPTIC
        if setting == "accurate":
            option.impratio = 100.0
            option.noslip_iterations = 20
            option.tolerance = 1e-10
            option.iterations = 200
            self.model.geom_solref[:] = [2.0 * time_step, 1.0]  # as stiff as the time step allows
            self.model.geom_solimp[:, :3] = [0.99, 0.999, 1e-4]
            self.model.eq_solref[:] = [2.0 * time_step, 1.0]
            self.model.eq_solimp[:, :3] = [0.99, 0.999, 1e-4]

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

    def extra(self) -> dict[str, float]:
        return {}


if __name__ == "__main__":
    _worker.main(mujoco.__version__, Engine)
