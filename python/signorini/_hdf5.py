"""HDF5 files that change whole or not at all.

HDF5 itself gets over neither a disk that is full (it crashes) nor a writer that is killed (what is left may make it
wait forever). So it never meets the disk: it makes a change in memory, which then goes to the file in this order.

1. What is new goes behind the end of the file, where nothing refers to it yet.
2. What is to be overwritten goes behind that, with a checksum: the journal.
3. It is overwritten.
4. The journal is cut off.

Before 2 is done, the file is what it was, and an error leaves it so; afterwards it is the new one, for `opened` reads
with the journal what has one. Between two changes the file is like any other.
"""

from __future__ import annotations

import fcntl
import os
import signal
import struct
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import SEEK_END, SEEK_SET, RawIOBase
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any

import h5py

Change = tuple[int, bytes]  # offset and what is there from now on
_MARK = b"signorini journal"
_FOOTER = struct.Struct(f"<QI{len(_MARK)}s")  # bytes of the journal, their checksum, the mark: the end of the file
_ENTRY = struct.Struct("<QQ")
_SIGNALS = sorted(signal.Signals, reverse=True)  # SIGINT last
_PATIENCE = 5.0  # how long to wait for others who have the file locked [s]


class _Changed(RawIOBase):
    """A file as it will be after some changes, which are in memory; it has the methods that HDF5 asks of a file."""

    def __init__(self, descriptor: int | None, changes: Iterable[Change] = ()) -> None:
        self._descriptor = descriptor
        self.changes = list(changes)
        self.end = 0 if descriptor is None else os.fstat(descriptor).st_size
        self._position = 0

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        self._position = offset + (self.end if whence == SEEK_END else 0)
        return self._position

    def tell(self) -> int:
        return self._position

    def readinto(self, buffer: Any) -> int:
        target = memoryview(buffer).cast("B")
        first, size = self._position, len(target)
        there = b"" if self._descriptor is None else os.pread(self._descriptor, size, first)
        target[:] = there.ljust(size, b"\0")
        for offset, data in self.changes:
            start, stop = max(first, offset), min(first + size, offset + len(data))
            if start < stop:
                target[start - first : stop - first] = data[start - offset : stop - offset]
        self._position += size
        return size

    def write(self, data: Any) -> int:
        self.changes.append((self._position, bytes(data)))
        self._position += len(data)
        self.end = max(self.end, self._position)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        self.end = self._position if size is None else size
        return self.end


def made(fill: Callable[[h5py.File], None]) -> bytes:
    """The bytes of a new HDF5 file."""
    changed = _Changed(None)
    with h5py.File(changed, "w", libver=("v110", "v110")) as file:
        fill(file)
    content = bytearray(changed.end)
    changed.seek(0)
    changed.readinto(content)
    return bytes(content)


def change(descriptor: int, work: Callable[[h5py.File], None], *, patient: bool) -> bool:
    """Lets work change an HDF5 file, and returns whether it did: if patient, not while others read it; if not, they
    have some seconds to end. Raises OSError, after which the file has the change whole or not at all."""
    if not _locked(descriptor, fcntl.LOCK_EX, 0.0 if patient else _PATIENCE) and patient:
        return False
    try:
        changed = _Changed(descriptor, _journal(descriptor))
        before = changed.end
        with h5py.File(changed, "r+", libver=("v110", "v110")) as file:
            work(file)
        _commit(descriptor, before, changed)
    finally:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_UN)
    return True


def _commit(descriptor: int, before: int, changed: _Changed) -> None:
    over = [entry for entry in changed.changes if entry[0] < before]
    if any(offset + len(data) > before for offset, data in over):  # behind a journal that was left; order matters
        over = changed.changes
    try:
        for offset, data in changed.changes:
            if offset >= before:
                _write(descriptor, offset, data)
        journal = b"".join(_ENTRY.pack(offset, len(data)) + data for offset, data in over)
        footer = _FOOTER.pack(len(journal), zlib.crc32(journal), _MARK)
        _write(descriptor, max(before, changed.end), journal + footer)
    except BaseException:
        with suppress(OSError):
            os.ftruncate(descriptor, before)
        raise
    for offset, data in over:
        _write(descriptor, offset, data)
    os.ftruncate(descriptor, changed.end)


@contextmanager
def signals_later() -> Iterator[None]:
    """Ctrl-C, and what handlers of other signals raise, come after the block: amid a call of HDF5 it would crash."""
    came: list[int] = []
    handlers: dict[signal.Signals, Any] = {}
    if current_thread() is main_thread():  # no other is interrupted
        handlers = {number: handler for number in _SIGNALS if callable(handler := signal.getsignal(number))}
    try:
        for number in handlers:
            signal.signal(number, lambda number, _: came.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for each in came:
        signal.raise_signal(each)


def _write(descriptor: int, offset: int, data: bytes) -> None:
    done = 0
    while done < len(data):
        done += os.pwrite(descriptor, data[done:], offset + done)


def _locked(descriptor: int, kind: int, patience: float) -> bool:
    until = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until:
                return False
            time.sleep(0.01)
        except OSError:  # a file system without locks
            return True
        else:
            return True


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file to read, whatever became of its writer. Raises OSError, as h5py does."""
    with path.open("rb") as there:
        if not _locked(there.fileno(), fcntl.LOCK_SH, _PATIENCE):
            raise OSError("another program is writing it")
        changes = _journal(there.fileno())
        with h5py.File(_Changed(there.fileno(), changes) if changes else path, "r") as file:
            yield file


def _journal(descriptor: int) -> list[Change]:
    end = os.fstat(descriptor).st_size - _FOOTER.size
    if end < 0:
        return []
    size, checksum, mark = _FOOTER.unpack(os.pread(descriptor, _FOOTER.size, end))
    if mark != _MARK or size > end:
        return []
    journal = os.pread(descriptor, size, end - size)
    if zlib.crc32(journal) != checksum:
        return []
    changes, position = [], 0
    while position + _ENTRY.size <= size:
        offset, length = _ENTRY.unpack_from(journal, position)
        position += _ENTRY.size + length
        changes.append((offset, journal[position - length : position]))
    return changes
