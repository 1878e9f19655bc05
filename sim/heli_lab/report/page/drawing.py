"""Render figures as PNG in two processes: threads would not help, because matplotlib holds Python's lock.

Run as a module, this file is the second process: it reads figures from standard input and writes PNG images
to standard output.
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

from heli_host.data.files import check_replaceable, figure_metadata, save_figure, write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI: Final = 110
_LENGTH: Final = struct.Struct("<q")


class Picture:
    """A figure that is, or will be, rendered into a PNG file with 110 dots per inch."""

    # ``str(picture)`` waits for the image and returns it as a data URL, so that a page needs no other file.

    def __init__(self, drawing: Drawing, figure: Figure, path: Path) -> None:
        check_replaceable(path)
        self._drawing, self.figure, self.path = drawing, figure, path
        self._png = b""

    def store(self, png: bytes) -> None:
        """Write the rendered image, `png`, into its file, and keep it in memory."""
        # `__init__` has checked the place, in the thread that knows whether --force was given.
        write_bytes(self.path, png, force=True)
        self._png = png

    def __str__(self) -> str:
        if not self._png:
            self._drawing.finish()
        return f"data:image/png;base64,{base64.b64encode(self._png).decode('ascii')}"


class Drawing:
    """A queue of figures: a second process renders from the beginning of the queue, this process from its
    end. With the name of a `vector_format`, each figure is also written in that format.
    """

    def __init__(self, use_process: bool = False, vector_format: str | None = None) -> None:
        self._vector_format = vector_format
        self._waiting: deque[Picture] = deque()
        # Held while the queue changes; notified when it has more figures, or is closed.
        self._more = threading.Condition()
        self._is_closed = not use_process
        self.process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._feed_process, daemon=True)
        if use_process:
            self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._more:
            self._waiting.clear()
        self.close()

    @property
    def waiting(self) -> int:
        """Number of figures in the queue."""
        return len(self._waiting)

    def add(self, figure: Figure, path: Path) -> Picture:
        """Queue a `figure` for the PNG file at `path`; the caller must not change it afterwards."""
        picture = Picture(self, figure, path)
        if self._vector_format is not None:
            save_figure(figure, path.with_suffix(f".{self._vector_format}"))
        with self._more:
            self._waiting.append(picture)
            self._more.notify()
        return picture

    def finish(self) -> None:
        """Render the remaining figures, and wait for the second process."""
        self._draw_waiting_figures()
        self.close()
        # If the second process ended early, its figure is in the queue again.
        self._draw_waiting_figures()

    def close(self) -> None:
        """End the second process after its current figure."""
        with self._more:
            self._is_closed = True
            self._more.notify()
        if self._thread.is_alive():
            self._thread.join()

    def _draw_waiting_figures(self) -> None:
        """Draw waiting figures in this process until none is left."""
        while True:
            with self._more:
                if not self._waiting:
                    return
                picture = self._waiting.pop()
            picture.store(png_of(picture.figure))

    def _take_next_figure(self) -> Picture | None:
        """Wait for the next figure of the queue, and take it; None if the queue is closed and empty."""
        with self._more:
            self._more.wait_for(lambda: self._waiting or self._is_closed)
            return self._waiting.popleft() if self._waiting else None

    def _feed_process(self) -> None:
        """Let the second process render the waiting figures, one after the other, and store the images."""
        try:
            self.process = process = subprocess.Popen(
                [sys.executable, "-m", "heli_lab.report.page.drawing"],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except OSError:
            return  # this process renders the figures itself
        assert process.stdin is not None
        assert process.stdout is not None
        # Closing the pipe of a process that has ended raises an OSError if the pipe still holds data.
        with suppress(OSError), process:
            while (picture := self._take_next_figure()) is not None:
                try:
                    _write_message(process.stdin, pickle.dumps(picture.figure))
                    png = _read_message(process.stdout)
                    if png:
                        picture.store(png)
                except OSError:
                    png = b""
                if not png:
                    # This process renders the figure, and an error then reaches the caller.
                    with self._more:
                        self._waiting.appendleft(picture)
                    break
            # The process may still be starting, and has no other work.
            process.kill()


def png_of(figure: Figure) -> bytes:
    """Render a `figure` as PNG with 110 dots per inch."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata=figure_metadata(".png"))
    return buffer.getvalue()


def _write_message(pipe: IO[bytes], content: bytes) -> None:
    """Write one message: its length, then its content."""
    pipe.write(_LENGTH.pack(len(content)) + content)
    pipe.flush()


def _read_message(pipe: IO[bytes]) -> bytes:
    """Read one message; return b"" if the other end is closed."""
    head = pipe.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return b""
    size = _LENGTH.unpack(head)[0]
    content = pipe.read(size)
    return content if len(content) == size else b""


def serve_drawings(figures: IO[bytes], pictures: IO[bytes]) -> None:
    """Read pickled `figures` and write them as PNG to `pictures`, until the input ends."""
    from matplotlib.backends import backend_agg
    from matplotlib.figure import Figure

    # Rendering an empty figure loads fonts and other resources before the first figure arrives.
    empty = Figure()
    backend_agg.FigureCanvasAgg(empty)
    empty.subplots().set_title("$t$")
    png_of(empty)
    while content := _read_message(figures):
        _write_message(pictures, png_of(pickle.loads(content)))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C
    serve_drawings(sys.stdin.buffer, sys.stdout.buffer)
