"""Draws the pictures of README.md and docs/pictures.md: python docs/pictures/make.py [NAME ...]"""

import sys
from pathlib import Path

import numpy as np

import signorini
from signorini import scenes
from signorini.scenes._worlds import Start
from signorini.view.picture import DIRECTION, Forces, Stage, write_png

FOLDER = Path(__file__).parent
SIZE = (576, 360)
#: Scene, its options, time [s], with forces, seen from, part of the picture that is left free.
PICTURES = {
    "cube-stack": ("cube-stack", {"slip": 0.3}, 0.3, True, DIRECTION, 0.06),
    "talos-fall": ("talos-fall", {}, 2.0, True, (1.0, -1.1, 0.6), 0.05),
    "spheres": ("spheres", {"size": 140}, 0.8, False, (1.0, -0.8, 0.7), 0.1),
    "hand": ("allegro-cubes", {}, 1.0, True, (1.0, 0.9, 0.5), 0.05),
    "solo": ("solo-terrain", {"slope": 15.0, "steps": 0.06, "seed": 1}, 2.0, True, (0.6, -1.0, 0.45), 0.3),
    "ur5": ("ur5-wall", {}, 0.01, True, (-0.75, -1.0, 0.4), 0.12),
}


def draw(name: str) -> None:
    scene, options, time, with_forces, direction, margin = PICTURES[name]
    world, q, v = scenes.worlds()[scene](**options)
    simulator = signorini.Simulator(world)
    simulator.state.q, simulator.state.v = q, v
    if name == "ur5":  # it presses with 40 N
        dt = simulator.settings.time_step
        found = signorini.inverse_dynamics(world, (q, v), v_next=v, dt=dt, impulse_guess=[[0.0, 0.0, 40.0 * dt]])
        simulator.applied_force = found.force
    known = scenes.worlds()[scene]
    controller = known.controller(simulator, Start(world, q, v), options) if known.controller else None
    simulator.run(max(1, round(time / simulator.settings.time_step)), controller=controller)
    stage = Stage.of_world(world, size=SIZE)
    state = np.array(simulator.state.q)
    forces = Forces.of(simulator.contacts) if with_forces else None
    camera = stage.camera([state], direction, margin)
    write_png(FOLDER / f"{name}.png", stage.draw(state, forces, camera=camera))
    print(f"{name}.png: {(FOLDER / f'{name}.png').stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    for chosen in sys.argv[1:] or PICTURES:
        draw(chosen)
