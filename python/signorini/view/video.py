"""Films without a screen: pictures at regular times, as AV1 in an MP4 file.

Pillow's AVIF plug-in encodes them (libaom); an AVIF sequence holds the same samples as an MP4 file. That is
written here (ISO/IEC 14496-12 and the AV1 binding to it).
"""

from __future__ import annotations

import io
import os
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from os import PathLike
from typing import Any

import numpy.typing as npt

from signorini import _files
from signorini._core import InvalidInputError
from signorini.view.picture import Camera, Forces, Image, Stage, checked_size, checked_suffix, force_scale

FPS = 30.0
_QUALITY = 80  # of 100
_SPEED = 8  # of 10; slower ones take longer than the drawing does
_TIMESCALE = 60000  # ticks a second in the file


def rows(duration: float, time_step: float, fps: float = FPS, speed: float = 1.0, start: float = 0.0) -> list[int]:
    """Which steps a film shows: duration [s, simulated] x fps / speed of them, the first at start [s]."""
    if not 1.0 <= fps <= 240.0:
        raise InvalidInputError(f"fps: is {fps}, must be in [1, 240]")
    if not 1e-3 <= speed <= 1e3:
        raise InvalidInputError(f"speed: is {speed}, must be in [0.001, 1000]")
    count = max(1, round(duration * fps / speed))
    if count > 100_000:
        raise InvalidInputError(f"fps: {fps} at speed {speed} makes {count} pictures, must be at most 100000")
    return [round((start + k * speed / fps) / time_step) for k in range(count)]


def film(
    path: str | PathLike[str],
    stage: Stage,
    states: Sequence[npt.ArrayLike],
    forces: Sequence[Forces | None] | None = None,
    *,
    fps: float = FPS,
    camera: Camera | None = None,
    progress: Callable[[], None] | None = None,
) -> None:
    """Writes a film of configurations, one a picture.

    forces: as many, or None. camera: None: one that sees all that moves, all the time. progress: called a picture.
    """
    path = checked_suffix(path, ".mp4")
    checked_size(stage.size, even=True)
    if not len(states):
        raise InvalidInputError("states: are none, must be at least one")
    if camera is None:
        camera = stage.camera(states[:: max(1, len(states) // 200)])
    shown = [None] * len(states) if forces is None else forces
    scale = force_scale([float(f.size.max(initial=0.0)) for f in shown if f is not None], stage.radius(camera))

    def draw(k: int) -> Image:
        return stage.draw(states[k], shown[k], camera=camera, force_scale=scale)

    def drawn() -> Iterator[Image]:
        for image in _in_order(draw, len(states)):
            if progress is not None:
                progress()
            yield image

    write_mp4(path, drawn(), len(states), stage.size, fps)


def _in_order(draw: Callable[[int], Image], count: int) -> Iterator[Image]:
    """draw(0), draw(1), ... from as many threads as there are cores, few pictures ahead."""
    workers = min(8, os.cpu_count() or 1)
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[Image]] = deque()
        try:
            for k in range(count):
                waiting.append(pool.submit(draw, k))
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def write_mp4(
    path: str | PathLike[str], images: Iterable[Image], count: int, size: tuple[int, int], fps: float = FPS
) -> None:
    """Writes pictures (height, width, 3) as a film. count: of them; size: (width, height), both even.

    The pictures are asked for one by one. Raises ImportError where Pillow is missing or cannot write AVIF.
    """
    path = checked_suffix(path, ".mp4")
    if count < 1:
        raise InvalidInputError(f"count: is {count}, must be at least 1")
    samples, keys, configuration = _encoded(images, count, checked_size(size, even=True))
    _files.write(path, _mp4(samples, keys, configuration, size, fps))


def _encoded(images: Iterable[Image], count: int, size: tuple[int, int]) -> tuple[list[bytes], list[int], bytes]:
    """AV1: what decodes to each picture, numbers from 1 of those that need no other, and the box av1C."""
    try:
        import PIL.features
        import PIL.Image
    except ImportError as error:
        raise ImportError(f"films: pillow encodes them: pip install 'signorini[view]' ({error})") from None
    if not PIL.features.check("avif"):
        raise ImportError("films: this pillow was built without AVIF; its wheels from 11.3 on have it")

    left = iter(images)

    class Pictures(PIL.Image.Image):
        """An image of many frames, each made when Pillow asks for it: no more than a few are in memory."""

        is_animated = True
        n_frames = max(2, count)  # Pillow makes a sequence of no less

        def __init__(self) -> None:
            super().__init__()
            self._at = -1
            self.seek(0)

        def seek(self, frame: int) -> None:
            if frame == self.n_frames:
                raise EOFError
            if frame != self._at + 1:  # Pillow goes back to the start in the end
                return
            self._at = frame
            if frame >= count:
                return
            array = next(left, None)
            if array is None:
                raise InvalidInputError(f"images: are {frame}, must be {count}")
            if array.shape != (size[1], size[0], 3):
                raise InvalidInputError(f"images: one has shape {array.shape}, must be ({size[1]}, {size[0]}, 3)")
            image = PIL.Image.fromarray(array)
            self._im, self._mode, self._size = image._im, image.mode, image.size

        def tell(self) -> int:
            return max(0, self._at)

    file = io.BytesIO()
    # BT.601 and limited range are what a decoder takes when it is not told, or does not listen.
    Pictures().save(
        file, "AVIF", save_all=True, quality=_QUALITY, speed=_SPEED, duration=round(1000 / FPS), subsampling="4:2:0",
        range="limited",
    )  # fmt: skip
    samples, keys, configuration = _samples(file.getvalue())
    return samples[:count], [key for key in keys if key <= count], configuration


# Boxes


def _boxes(data: bytes, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Type, begin and end of the content of each box."""
    while start + 8 <= end:
        length, kind = struct.unpack_from(">I4s", data, start)
        head = 8
        if length == 1:
            (length,) = struct.unpack_from(">Q", data, start + 8)
            head = 16
        stop = end if length == 0 else start + length
        yield kind, start + head, stop
        start = stop


def _find(data: bytes, path: str, start: int, end: int) -> tuple[int, int]:
    for name in path.split("/"):
        found = next(((a, b) for kind, a, b in _boxes(data, start, end) if kind == name.encode()), None)
        if found is None:
            raise RuntimeError(f"Pillow's AVIF sequence has no box {name} of {path}")
        start, end = found
    return start, end


def _samples(avif: bytes) -> tuple[list[bytes], list[int], bytes]:
    table = _find(avif, "moov/trak/mdia/minf/stbl", 0, len(avif))

    def numbers(box: str, skip: int, width: int = 1) -> list[tuple[int, ...]]:
        start, _ = _find(avif, box, *table)
        (count,) = struct.unpack_from(">I", avif, start + skip)
        form = ">" + "I" * width
        return [struct.unpack_from(form, avif, start + skip + 4 + k * 4 * width) for k in range(count)]

    start, _ = _find(avif, "stsz", *table)
    (fixed,) = struct.unpack_from(">I", avif, start + 4)
    (count,) = struct.unpack_from(">I", avif, start + 8)
    sizes = [fixed] * count if fixed else [size for (size,) in numbers("stsz", 8)]
    offsets = [offset for (offset,) in numbers("stco", 4)]
    runs = numbers("stsc", 4, 3)  # first chunk, samples in each chunk, description
    samples: list[bytes] = []
    for chunk, offset in enumerate(offsets, 1):
        in_chunk = next(run[1] for run in reversed(runs) if run[0] <= chunk)
        for size in sizes[len(samples) : len(samples) + in_chunk]:
            samples.append(avif[offset : offset + size])
            offset += size
    try:
        keys = [key for (key,) in numbers("stss", 4)]
    except RuntimeError:  # all of them
        keys = list(range(1, len(samples) + 1))
    entries, end = _find(avif, "stsd", *table)
    entry, entry_end = _find(avif, "av01", entries + 8, end)
    first, last = _find(avif, "av1C", entry + 78, entry_end)
    return samples, keys, avif[first - 8 : last]


def _box(kind: str, *content: bytes) -> bytes:
    body = b"".join(content)
    return struct.pack(">I", 8 + len(body)) + kind.encode() + body


def _full_box(kind: str, *content: bytes, flags: int = 0) -> bytes:
    return _box(kind, struct.pack(">I", flags), *content)


_MATRIX = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)


def _mp4(samples: list[bytes], keys: list[int], configuration: bytes, size: tuple[int, int], fps: float) -> bytes:
    """The description before the samples, so that playing can start before all has arrived."""
    width, height = size
    tick = round(_TIMESCALE / fps)
    duration = tick * len(samples)
    entry = _box(
        "av01",
        struct.pack(">6xH16xHHIIIH32sHh", 1, width, height, 0x480000, 0x480000, 0, 1, b"\0" * 32, 24, -1),
        configuration,
        _box("colr", b"nclx", struct.pack(">HHHB", 1, 13, 6, 0)),
    )

    def table(offset: int) -> bytes:
        return _box(
            "stbl",
            _full_box("stsd", struct.pack(">I", 1), entry),
            _full_box("stts", struct.pack(">III", 1, len(samples), tick)),
            _full_box("stss", struct.pack(f">{1 + len(keys)}I", len(keys), *keys)),
            _full_box("stsc", struct.pack(">IIII", 1, 1, len(samples), 1)),
            _full_box("stsz", struct.pack(f">{2 + len(samples)}I", 0, len(samples), *map(len, samples))),
            _full_box("co64", struct.pack(">IQ", 1, offset)),
        )

    def movie(offset: int) -> bytes:
        times: tuple[Any, ...] = (0, 0)
        media = _box(
            "mdia",
            _full_box("mdhd", struct.pack(">IIIIHH", *times, _TIMESCALE, duration, 0x55C4, 0)),  # no language
            _full_box("hdlr", struct.pack(">I4s12x", 0, b"vide"), b"pictures\0"),
            _box(
                "minf",
                _full_box("vmhd", struct.pack(">4H", 0, 0, 0, 0), flags=1),
                _box("dinf", _full_box("dref", struct.pack(">I", 1), _full_box("url ", flags=1))),
                table(offset),
            ),
        )
        head = struct.pack(">IIII", *times, 1, 0)
        track = _full_box(
            "tkhd", head, struct.pack(">I8xhhhH", duration, 0, 0, 0, 0), _MATRIX,
            struct.pack(">II", width << 16, height << 16), flags=3,
        )  # fmt: skip
        return _box(
            "moov",
            _full_box(
                "mvhd", struct.pack(">IIIIIH10x", *times, _TIMESCALE, duration, 0x10000, 0x100), _MATRIX,
                struct.pack(">24xI", 2),
            ),
            _box("trak", track, media),
        )  # fmt: skip

    kind = _box("ftyp", b"isom", struct.pack(">I", 512), b"isomiso6av01mp41")
    start = len(kind) + len(movie(0)) + 8
    return kind + movie(start) + _box("mdat", *samples)
