"""Standard output and errors that never decide how a command ends: its exit status is that of its work."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any


class _Pipe(io.FileIO):
    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.EBADF):  # the reader has gone, as `| head` does; 1</dev/null
                raise
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return memoryview(data).nbytes


def guard() -> None:
    """What nobody reads any more is dropped; what the encoding lacks is written as an escape."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the shell, >&-
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
            continue
        try:
            number = stream.fileno()
        except (AttributeError, OSError, ValueError):  # a notebook's, or a test's
            continue
        pipe = io.BufferedWriter(_Pipe(number, "w", closefd=False))
        encoding, by_line = stream.encoding, stream.line_buffering or stream.write_through
        setattr(sys, name, io.TextIOWrapper(pipe, encoding, "backslashreplace", line_buffering=by_line))
