"""XML that strangers wrote: elements that know their line, no document types, no entities, bounded size and depth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError

Array = npt.NDArray[np.float64]

MAX_BYTES = 256 * 2**20
MAX_DEPTH = 200
MAX_ELEMENTS = 1_000_000


@dataclass(eq=False)
class Element:
    """One element: tag, attributes, text, children, the line it starts at and the file it is in."""

    tag: str
    attributes: dict[str, str]
    line: int
    file: Path
    parent: Element | None = field(default=None, repr=False)
    children: list[Element] = field(default_factory=list, repr=False)
    text: str = field(default="", repr=False)

    def __iter__(self) -> Iterator[Element]:
        return iter(self.children)

    @property
    def place(self) -> str:
        """Which element this is, for a person: robot/link "base"/inertial."""
        name = self.attributes.get("name") or self.attributes.get("id")
        own = f'{self.tag} "{_short(name)}"' if name else self.tag
        return own if self.parent is None or self.parent.parent is None else f"{self.parent.place}/{own}"

    def fail(self, reason: str) -> NoReturn:
        """Raises InvalidInputError: file, line, element, reason."""
        raise InvalidInputError(f"{self.file}:{self.line}: {self.place}: {reason}")

    def all(self, tag: str) -> list[Element]:
        return [child for child in self.children if child.tag == tag]

    def find(self, tag: str) -> Element | None:
        """The only child with this tag, None without one. Raises InvalidInputError when there are several."""
        found = self.all(tag)
        if len(found) > 1:
            found[1].fail(f"is the second <{tag}> of its element, at most one is allowed")
        return found[0] if found else None

    def need(self, tag: str) -> Element:
        return self.find(tag) or self.fail(f"has no <{tag}>")

    def flattened(self) -> Element:
        """The same element with texts as attributes, as SDF has them: its own is "text", those of children without
        children have the children's names."""
        attributes = dict(self.attributes)
        if not self.children and self.text.strip():
            attributes["text"] = self.text.strip()
        seen = set()
        for child in self.children:
            if child.tag in seen:
                child.fail(f"is the second <{child.tag}> of its element, at most one is allowed")
            seen.add(child.tag)
            if not child.children:
                attributes[child.tag] = child.text.strip()
        return Element(self.tag, attributes, self.line, self.file, self.parent, self.children)

    def flag(self, name: str, default: bool = False) -> bool:
        """An attribute as true or false."""
        word = self.string(name, str(default)).strip().lower()
        if word not in ("true", "1", "false", "0"):
            self.fail(f'{name} is "{_short(word)}", must be true, false, 1 or 0')
        return word in ("true", "1")

    def string(self, name: str, default: str | None = None) -> str:
        value = self.attributes.get(name, default)
        if value is None:
            self.fail(f"has no attribute {name}")
        if not value.strip():
            self.fail(f"{name} is empty")
        return value

    def number(
        self,
        name: str,
        default: float | None = None,
        lower: float = -math.inf,
        upper: float = math.inf,
        infinite: bool = False,
    ) -> float:
        """An attribute as a number in [lower, upper], finite unless `infinite`."""
        if name not in self.attributes and default is not None:
            return default
        return float(self._numbers(name, 1, lower, upper, infinite)[0])

    def vector(self, name: str, size: int, default: tuple[float, ...] | None = None, limit: float = math.inf) -> Array:
        """An attribute as `size` finite numbers in [-limit, limit]."""
        if name not in self.attributes and default is not None:
            return np.array(default, dtype=np.float64)
        return self._numbers(name, size, -limit, limit)

    def _numbers(self, name: str, size: int, lower: float, upper: float, infinite: bool = False) -> Array:
        text = self.string(name)
        words = text.split(maxsplit=size)
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            self.fail(f'{name} is "{_short(text)}", must be {_count(size)}')
        if len(values) != size:
            self.fail(f'{name} is "{_short(text)}", must be {_count(size)}')
        if np.isnan(values).any() or (not infinite and np.isinf(values).any()):
            self.fail(f'{name} is "{_short(text)}", must be {"no NaN" if infinite else "finite"}')
        if (values < lower).any() or (values > upper).any():
            self.fail(f'{name} is "{_short(text)}", must be {_range(lower, upper)}')
        return values


def parse(path: Path) -> Element:
    """The root element of a file. Raises InvalidInputError for what is not plain, well-formed, bounded XML."""
    return _Builder(path).parse(_data(path))


def root_tag(path: Path) -> str:
    """The tag of the root element; the rest of the file may be anything."""

    class Found(Exception):  # noqa: N818
        pass

    def start(tag: str, _: dict[str, str]) -> None:
        raise Found(tag)

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    try:
        parser.Parse(_data(path), True)
    except Found as found:
        return str(found)
    except InvalidInputError:
        raise  # there is no file, or not one that is read
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise InvalidInputError(f"{path}: is no XML file: {error}") from None
    raise InvalidInputError(f"{path}: has no element")


def _data(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise InvalidInputError(f"{path}: {'is no regular file' if path.exists() else 'there is no such file'}")
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInputError(f"{path}: has {path.stat().st_size} bytes, at most {MAX_BYTES} are read")
        return path.read_bytes()
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be read: {error.strerror}") from None


class _Builder:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._root: Element | None = None
        self._open: list[Element] = []
        self._texts: list[list[str]] = []
        self._num_elements = 0
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._doctype
        self._parser = parser

    def parse(self, data: bytes) -> Element:
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            inside = f" inside {self._open[-1].place}" if self._open else ""
            reason = expat.errors.messages.get(error.code, str(error))
            raise InvalidInputError(f"{self._path}:{error.lineno}: is no well-formed XML{inside}: {reason}") from None
        except (LookupError, ValueError) as error:
            if isinstance(error, InvalidInputError):
                raise
            raise InvalidInputError(f"{self._path}: is in an encoding that is not known: {error}") from None
        assert self._root is not None
        return self._root

    def _fail(self, reason: str) -> NoReturn:
        raise InvalidInputError(f"{self._path}:{self._parser.CurrentLineNumber}: {reason}")

    def _doctype(self, *_: object) -> None:
        self._fail("has a document type declaration (<!DOCTYPE ...>), which is not allowed here; remove it")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._num_elements += 1
        if self._num_elements > MAX_ELEMENTS:
            self._fail(f"has more than {MAX_ELEMENTS} elements")
        if len(self._open) >= MAX_DEPTH:
            self._fail(f"nests elements more than {MAX_DEPTH} deep")
        parent = self._open[-1] if self._open else None
        element = Element(tag, attributes, self._parser.CurrentLineNumber, self._path, parent)
        if parent is None:
            self._root = element
        else:
            parent.children.append(element)
        self._open.append(element)
        self._texts.append([])

    def _end(self, _: str) -> None:
        element = self._open.pop()
        element.text = "".join(self._texts.pop())

    def _characters(self, text: str) -> None:
        self._texts[-1].append(text)


def _count(size: int) -> str:
    return "a number" if size == 1 else f"{size} numbers"


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def _range(lower: float, upper: float) -> str:
    if upper == math.inf:
        return f"at least {lower:g}"
    return f"at most {upper:g}" if lower == -math.inf else f"in [{lower:g}, {upper:g}]"
