"""A look at an MJCF file before MuJoCo's compiler gets it: what makes that hang, crash or fill the memory is refused.

That is: included, attached and asset files that are no regular files (a FIFO, a device), files that attach themselves,
counts without measure. All else is left to the compiler.
"""

from __future__ import annotations

import math
import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from signorini._core import InvalidInputError

MAX_BYTES = 256 * 2**20  # of an XML file
MAX_FILE_BYTES = 512 * 2**20  # of a mesh, picture, ...
MAX_DEPTH = 500  # MuJoCo's own limit
MAX_ELEMENTS = 1_000_000  # with all copies
MAX_NUMBERS = 100_000_000  # of one height field, texture, ...
MAX_SIZE = 1_000_000  # of what <size> and nsample set
#: Attributes whose numbers, multiplied, say how much an element becomes.
_ELEMENTS = {"replicate": ("count",), "composite": ("count",), "flexcomp": ("count",)}
_NUMBERS = {"hfield": ("nrow", "ncol"), "texture": ("width", "height"), "numeric": ("size",)}
_FOLDERS = ("assetdir", "meshdir", "texturedir")


@dataclass
class _Scanned:
    """One file. elements: with its copies, without what it includes and attaches; those by name, with how often."""

    elements: int = 0
    includes: list[tuple[str, int, int]] = field(default_factory=list)  # file, line, times
    attached: list[tuple[str, int, int]] = field(default_factory=list)  # model, line, times
    models: dict[str, tuple[str, int]] = field(default_factory=dict)  # by name: file, line
    files: list[tuple[str, str, int]] = field(default_factory=list)  # element, file, line
    folders: set[str] = field(default_factory=set)


def scan(path: Path) -> None:
    """Raises InvalidInputError: file, line, element, reason."""
    _Scan(path).weight(path, [])


class _Scan:
    def __init__(self, main: Path) -> None:
        self._main = main
        self._scanned: dict[str, _Scanned] = {}
        self._weights: dict[str, int] = {}

    def _fail(self, path: Path, line: int, reason: str) -> NoReturn:
        where = f"{path}:{line}" if path == self._main else f"{self._main}: {path}:{line}"
        raise InvalidInputError(f"{where}: {reason}") from None

    def weight(self, path: Path, above: list[str]) -> int:
        """Elements of a file with all that it includes and attaches. above: files that lead to it."""
        key = os.path.realpath(path)
        if key in self._weights:
            return self._weights[key]
        found = self._scanned[key] = self._read(path)
        folders = {path.parent, self._main.parent}
        folders |= {
            folder / name for folder in folders for scanned in self._scanned.values() for name in scanned.folders
        }
        total = found.elements
        above = [*above, key]
        for name, line, times in found.includes:
            total += times * self._below(path, "include", name, line, folders, above)
        weights = {}
        for model, (name, line) in found.models.items():
            weights[model] = self._below(path, "model", name, line, folders, above)
        for model, _, times in found.attached:
            total += times * weights.get(model, 0)
        if total > MAX_ELEMENTS:
            self._fail(path, 1, f"has {total} elements when all copies are counted, at most {MAX_ELEMENTS} are read")
        # Only now are the folders of included files known.
        folders |= {
            folder / name for folder in folders for scanned in self._scanned.values() for name in scanned.folders
        }
        for tag, name, line in found.files:
            for folder in folders:
                self._check(path, tag, name, line, folder / name)
                self._check(path, tag, name, line, folder / os.path.basename(name))  # strippath
        self._weights[key] = total
        return total

    def _below(self, path: Path, tag: str, name: str, line: int, folders: set[Path], above: list[str]) -> int:
        weight = 0
        for folder in (path.parent, *sorted(folders)):
            if not self._check(path, tag, name, line, folder / name):
                continue
            part_of_it = os.path.realpath(folder / name) in above
            if part_of_it and tag == "model":
                self._fail(path, line, f'<model>: file is "{name}", which this file is part of')
            if not part_of_it and not name.lower().endswith((".mjb", ".urdf")):
                weight = max(weight, self.weight(folder / name, above))
            if tag == "model":
                break
        return weight

    def _check(self, path: Path, tag: str, name: str, line: int, file: Path) -> bool:
        """Whether a file is there; one that is no regular file or too large is refused."""
        try:
            status = file.stat()
        except (OSError, ValueError):
            return False
        if stat.S_ISDIR(status.st_mode) and tag != "include":
            return False
        if not stat.S_ISREG(status.st_mode):
            self._fail(path, line, f'<{tag}>: file is "{name[:200]}", which is no regular file')
        if status.st_size > MAX_FILE_BYTES:
            self._fail(
                path,
                line,
                f'<{tag}>: file "{name[:200]}" has {status.st_size} bytes, at most {MAX_FILE_BYTES} are read',
            )
        return True

    def _read(self, path: Path) -> _Scanned:
        try:
            size = path.stat().st_size
            data = path.read_bytes() if size <= MAX_BYTES else b""
        except OSError as error:
            raise InvalidInputError(f"{path}: cannot be read: {error.strerror}") from None
        if size > MAX_BYTES:
            raise InvalidInputError(f"{path}: has {size} bytes, at most {MAX_BYTES} are read")
        return _Reader(self, path).read(data)


class _Reader:
    """One file's elements as they come."""

    def __init__(self, scan: _Scan, path: Path) -> None:
        self._scan, self._path = scan, path
        self._found = _Scanned()
        self._times = [1]  # how often each open element is there
        parser = self._parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = lambda _: self._times.pop()
        parser.StartDoctypeDeclHandler = lambda *_: self._fail("has a <!DOCTYPE>, which is not read")

    def read(self, data: bytes) -> _Scanned:
        # MuJoCo reads -- in comments, XML does not.
        data = re.sub(rb"<!--.*?-->", lambda comment: b"\n" * comment[0].count(b"\n"), data, flags=re.DOTALL)
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            reason = expat.errors.messages.get(error.code, str(error))
            self._scan._fail(self._path, error.lineno, f"is no well-formed XML: {reason}")
        except (LookupError, ValueError) as error:
            if isinstance(error, InvalidInputError):
                raise
            self._scan._fail(self._path, 1, f"is in an encoding that is not known: {error}")
        return self._found

    def _fail(self, reason: str) -> NoReturn:
        self._scan._fail(self._path, self._parser.CurrentLineNumber, reason)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        found, times, line = self._found, self._times[-1], self._parser.CurrentLineNumber
        if len(self._times) > MAX_DEPTH:
            self._fail(f"<{tag}>: is more than {MAX_DEPTH} levels deep")
        for name in _NUMBERS.get(tag, ()):
            self._limit(tag, name, attributes, MAX_NUMBERS)
        if self._product(tag, _NUMBERS.get(tag, ()), attributes) > MAX_NUMBERS:
            self._fail(f"<{tag}>: {' x '.join(_NUMBERS[tag])} are more than {MAX_NUMBERS} numbers")
        for name in attributes:
            if name == "nsample" or (tag == "size" and name.startswith("n")):
                self._limit(tag, name, attributes, MAX_SIZE)
        copies = self._product(tag, _ELEMENTS.get(tag, ()), attributes)
        found.elements += times if tag == "replicate" else times * copies
        if found.elements > MAX_ELEMENTS or times * copies > MAX_ELEMENTS:
            self._fail(f"<{tag}>: makes more than {MAX_ELEMENTS} elements when all copies are counted")
        self._times.append(times * copies if tag == "replicate" else times)
        if tag == "compiler":
            found.folders |= {attributes[name] for name in _FOLDERS if name in attributes}
        if tag == "attach":
            found.attached.append((attributes.get("model", ""), line, times))
        file = attributes.get("file", "")
        if tag == "include" and file:
            found.includes.append((file, line, times))
        elif tag == "model" and file:
            found.models[attributes.get("name", Path(file).stem)] = file, line
        else:
            found.files += [(tag, v, line) for name, v in attributes.items() if name.startswith("file") and v]

    def _limit(self, tag: str, name: str, attributes: dict[str, str], limit: int) -> None:
        if self._product(tag, (name,), attributes) > limit:
            self._fail(f'<{tag}>: {name} is "{attributes[name][:40]}", must be at most {limit}')

    @staticmethod
    def _product(tag: str, names: tuple[str, ...], attributes: dict[str, str]) -> int:
        """Of all the numbers in some attributes; what is no number, or less than 1, is left to MuJoCo."""
        product = 1
        for name in names:
            for word in attributes.get(name, "").split()[:8]:
                try:
                    value = float(word)
                except ValueError:
                    continue
                product *= max(1, int(value)) if math.isfinite(value) else 1
        return product
