"""The settings that MuJoCo is run in, everywhere; imports MuJoCo alone, since its process may have nothing else."""

from __future__ import annotations

from typing import Any

import mujoco

SETTINGS = ("pyramidal", "elliptic", "accurate")


def apply(model: Any, setting: str, time_step: float) -> None:
    """Changes an MjModel. Newton's method and one thread, the defaults, in all; "accurate" is what makes it most rigid.

    time_step [s]: set too. Raises ValueError for a setting that is none.
    """
    if setting not in SETTINGS:
        raise ValueError(f"setting: is {setting!r}, must be one of {', '.join(SETTINGS)}")
    option = model.opt
    option.timestep = time_step
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL if setting == "pyramidal" else mujoco.mjtCone.mjCONE_ELLIPTIC
    if setting == "accurate":
        option.impratio = 100.0
        option.noslip_iterations = 20
        option.tolerance = 1e-10
        option.iterations = 200
        for solref, solimp in ((model.geom_solref, model.geom_solimp), (model.eq_solref, model.eq_solimp)):
            solref[:] = [2.0 * time_step, 1.0]  # as stiff as the time step allows
            solimp[:, :3] = [0.99, 0.999, 1e-4]
