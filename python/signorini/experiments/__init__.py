"""The paper's figures and tables about single problems, and our own benchmarks; one a file, run by

    signorini experiment NAME --output DIR

Each writes NAME.json and NAME.png there and returns a Report with a line of verdict a claim.
"""

from signorini.experiments._data import DataMissingError, data_directory
from signorini.experiments._report import Options, Report, Verdict

__all__ = ["DataMissingError", "Options", "Report", "Verdict", "data_directory"]
