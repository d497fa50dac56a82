"""What `make demo` runs: the cube stack and, where there are any, problem files, solved and certified."""

import os
import sys
import tempfile
from pathlib import Path

import signorini
from signorini import fclib, scenes
from signorini.cli import main


def run() -> None:
    data = os.environ.get("SIGNORINI_DATA", "")
    with tempfile.TemporaryDirectory() as folder:
        for ratio in (1.0, 100.0, 10000.0):
            for slip in (0.0, 0.05, 0.5):
                problem = scenes.cube_stack(mass_ratio=ratio, slip=slip)
                fclib.write(Path(folder, f"{problem.name}.hdf5"), problem)
        files = [folder]
        if data and Path(data).is_dir():
            for family in sorted(Path(data).iterdir()):
                paths = sorted(family.glob("*.hdf5"))
                files += [str(path) for path in paths[:: max(1, len(paths) // 10)]]
        else:
            print(f"No problem files at {data or '$SIGNORINI_DATA'}: only the cube stack, then.")
        sys.argv = ["signorini", "solve", "--tolerance", "1e-8", *files]
        print(f"signorini {signorini.__version__}")
        print(
            "Stacks of 15 cubes, named by the mass ratio of top to bottom and the tangential velocity at the top [m/s]:"
        )
        main.main()


run()
