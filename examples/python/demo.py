"""What `make demo` runs: the paper's stack of 15 cubes, 1 kg to 10 000 kg, for two seconds, certified and recorded."""

import sys

import signorini
from signorini.cli import main

print(f"signorini {signorini.__version__}: 15 cubes on each other, 1 kg at the bottom, 10 000 kg at the top")
sys.argv = ["signorini", "run", "cube-stack", "--duration", "2", "--record", "cube-stack.h5"]
main.main()
