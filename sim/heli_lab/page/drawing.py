"""Figures turned into PNG: matplotlib holds Python's lock, so a process beside draws half of them.

Run as a module, this is that process: it takes figures from its standard input and answers with pictures.
"""

from __future__ import annotations

import base64
import io
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI: Final = 110
_LENGTH: Final = struct.Struct("<q")


class Picture:
    """A `figure` that a `drawing` draws into the file at `path`. As text it is an address that holds the
    whole picture as PNG, 110 dots per inch, so that a page needs no other file; who asks waits for it.
    """

    def __init__(self, drawing: Drawing, figure: Figure, path: Path) -> None:
        self._drawing, self.figure, self.path = drawing, figure, path
        self._png = b""

    def keep(self, png: bytes) -> None:
        """Write the drawn picture, a `png`, into its file, and keep it."""
        self.path.write_bytes(png)
        self._png = png

    def __str__(self) -> str:
        if not self._png:
            self._drawing.finish()
        return f"data:image/png;base64,{base64.b64encode(self._png).decode('ascii')}"


class Drawing:
    """Figures to draw, the first ones by a process beside, the last ones here.

    Parameters
    ----------
    beside : bool
        Start that process, which is ready a second later. Where it cannot be started, or dies, all is drawn
        here.

    Attributes
    ----------
    process : subprocess.Popen or None
        The process beside, once it was started.
    """

    def __init__(self, beside: bool = False) -> None:
        self._waiting: deque[Picture] = deque()
        self._more = threading.Condition()
        self._ended = not beside
        self.process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._hand_over, daemon=True)
        if beside:
            self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.clear()
        self.close()

    @property
    def waiting(self) -> int:
        """Figures that nobody draws yet."""
        return len(self._waiting)

    def add(self, figure: Figure, path: Path) -> Picture:
        """Have a `figure` drawn into the file at `path`; it must not be changed any more."""
        picture = Picture(self, figure, path)
        with self._more:
            self._waiting.append(picture)
            self._more.notify()
        return picture

    def finish(self) -> None:
        """Draw what nobody draws yet, and wait for the rest."""
        self._draw()
        self.close()
        # A process that died has left what it was drawing.
        self._draw()

    def close(self) -> None:
        """End the process beside, once it has drawn what it draws."""
        with self._more:
            self._ended = True
            self._more.notify()
        if self._thread.is_alive():
            self._thread.join()

    def _draw(self) -> None:
        while self._waiting:
            try:
                picture = self._waiting.pop()
            except IndexError:  # the process beside was quicker
                return
            picture.keep(png_of(picture.figure))

    def _next(self) -> Picture | None:
        with self._more:
            self._more.wait_for(lambda: self._waiting or self._ended)
            return self._waiting.popleft() if self._waiting else None

    def _hand_over(self) -> None:
        try:
            self.process = process = subprocess.Popen(
                [sys.executable, "-m", "heli_lab.page.drawing"],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except OSError:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        # What is left in its pipe cannot be written once it is gone.
        with suppress(OSError), process:
            while (picture := self._next()) is not None:
                try:
                    _write(process.stdin, pickle.dumps(picture.figure))
                    png = _read(process.stdout)
                    if png:
                        picture.keep(png)
                except OSError:
                    png = b""
                if not png:
                    # Drawn here it is drawn, or what stands in the way is raised where it is told.
                    self._waiting.appendleft(picture)
                    break
            # It has nothing that could be lost, and may still be starting.
            process.kill()


def png_of(figure: Figure) -> bytes:
    """Draw a `figure` as PNG, 110 dots per inch."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def _write(pipe: IO[bytes], content: bytes) -> None:
    pipe.write(_LENGTH.pack(len(content)) + content)
    pipe.flush()


def _read(pipe: IO[bytes]) -> bytes:
    """What was written at the other end; nothing where that has gone."""
    head = pipe.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return b""
    size = _LENGTH.unpack(head)[0]
    content = pipe.read(size)
    return content if len(content) == size else b""


def serve_drawings(figures: IO[bytes], pictures: IO[bytes]) -> None:
    """Draw `figures`, each pickled, into `pictures`, until nobody gives any."""
    from matplotlib.backends import backend_agg
    from matplotlib.figure import Figure

    # What a first figure pays for, such as fonts, is paid for before there is one.
    first = Figure()
    backend_agg.FigureCanvasAgg(first)
    first.subplots().set_title("$t$")
    png_of(first)
    while content := _read(figures):
        _write(pictures, png_of(pickle.loads(content)))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever gives the figures
    serve_drawings(sys.stdin.buffer, sys.stdout.buffer)
