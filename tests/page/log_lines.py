"""Lines that the server of a page logs."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


class _Lines(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []
        self.setFormatter(logging.Formatter("%(message)s"))

    def emit(self, record: logging.LogRecord) -> None:
        # With its trace, where there is one.
        self.lines.append(self.format(record))


@contextmanager
def log_lines() -> Iterator[list[str]]:
    """Collect what is logged in a block; the server must run before it begins."""
    lines = _Lines()
    # The logger of uvicorn hands nothing on to the root.
    loggers = [logging.getLogger(name) for name in ("", "uvicorn")]
    for logger in loggers:
        logger.addHandler(lines)
    try:
        yield lines.lines
    finally:
        for logger in loggers:
            logger.removeHandler(lines)


def traces(lines: list[str]) -> list[str]:
    """Lines that look like a crash: several for one cause, or words of asyncio."""
    return [line for line in lines if "\n" in line or "never retrieved" in line]
