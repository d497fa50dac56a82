"""Contact problems to try, test and measure with, built from geometry and the same ones for the same seed."""

from signorini.scenes._granular import chain, pile
from signorini.scenes._stacks import cube_stack, wall
from signorini.scenes.stress import STRESSES, scaled_masses, with_compliance, with_friction

__all__ = ["STRESSES", "chain", "cube_stack", "pile", "scaled_masses", "wall", "with_compliance", "with_friction"]
