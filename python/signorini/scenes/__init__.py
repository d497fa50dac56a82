"""Contact problems and worlds to try, test and measure with, the same ones for the same seed.

`cube_stack`, `wall`, `pile` and `chain` are contact problems built from geometry; `worlds()` are worlds to simulate.
"""

from signorini.scenes._granular import chain, pile
from signorini.scenes._stacks import cube_stack, wall
from signorini.scenes._worlds import Start, WorldScene, robots_folder, worlds
from signorini.scenes.stress import STRESSES, scaled_masses, with_compliance, with_friction

__all__ = [
    "STRESSES",
    "Start",
    "WorldScene",
    "chain",
    "cube_stack",
    "pile",
    "robots_folder",
    "scaled_masses",
    "wall",
    "with_compliance",
    "with_friction",
    "worlds",
]
