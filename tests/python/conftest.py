import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of problem files; tests that need it are skipped, visibly, where it is absent."""
    folder = Path(os.environ.get("SIGNORINI_DATA") or REPOSITORY.parent / "shared" / "data" / "contact_problems")
    if not folder.is_dir():
        pytest.skip(f"no problem files at {folder}; set SIGNORINI_DATA")
    return folder
