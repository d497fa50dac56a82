"""What the commands share: errors in red, JSON to a file or to standard output."""

from __future__ import annotations

import json
import math
import sys
from typing import Any

from rich.console import Console

from signorini import _files


def report(errors: Console, error: Any) -> None:
    errors.print(f"error: {error}", style="red", markup=False, highlight=False, soft_wrap=True)


def finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None  # JSON knows neither NaN nor infinity


def write_json(target: str, content: dict[str, Any], errors: Console) -> bool:
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    try:
        if target == "-":
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            _files.write(target, text.encode())
    except OSError as error:
        report(errors, error)
        return False
    return True
