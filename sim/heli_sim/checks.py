"""Checks of this computer for the simulation, for ``heli-host doctor``."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from heli_host.ui.cli.doctor import Finding, Verdict


def examine() -> Iterator[Finding]:
    """Run all checks and yield one finding at a time, basic ones first."""
    yield check_core()
    yield check_compiler()
    yield check_cache()
    yield check_pseudo_terminal()


def check_core() -> Finding:
    """Check that the flight code is compiled for this machine. Without it nothing can be simulated."""
    try:
        import heli_sim._native  # noqa: F401  -- whether it loads is the question
    except ImportError as error:
        return Finding(Verdict.BAD, f"the simulated board does not load: {error}", "run: make setup")
    return Finding(Verdict.GOOD, "simulated board: the flight code compiled for this machine loads")


def check_compiler() -> Finding:
    """Check for a C compiler. Without one all functions work, but the equations of a rig take 50 times as
    long.
    """
    wanted = [name for name in (os.environ.get("CC"), "cc", "gcc", "clang") if name]
    for name in wanted:
        path = shutil.which(name)
        if path:
            return Finding(Verdict.GOOD, f"C compiler: {path}")
    return Finding(
        Verdict.NOTE,
        "no C compiler: the simulated rig's equations run about 50 times slower",
        "install one, for example: sudo apt-get install g++",
    )


def check_cache() -> Finding:
    """Check that the cache of compiled equations can be written, and by this user only."""
    from heli_sim.evaluate.compiled import cache_path, writable_by_others

    base = os.environ.get("XDG_CACHE_HOME")
    folder = Path(base) if base else Path.home() / ".cache"
    probe = folder / f"heli-doctor-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        return Finding(
            Verdict.BAD,
            f"cache folder {folder} cannot be written: {error.strerror}",
            "choose another folder: set XDG_CACHE_HOME in the environment",
        )
    if cache_path().exists() and (danger := writable_by_others(cache_path())):
        return Finding(Verdict.BAD, danger, f"check who wrote there, then: rm -r {cache_path()}")
    return Finding(Verdict.GOOD, f"cache folder {folder} can be written")


def check_pseudo_terminal() -> Finding:
    """Check that pseudo-terminals exist and accept the unusual baud rate of the link. On systems without
    pseudo-terminals the finding is a note.
    """
    from heli_host.declaration import BAUD

    if not hasattr(os, "openpty"):
        return Finding(
            Verdict.NOTE,
            "no pseudo-terminals on this system",
            "no action needed: boards are simulated in process, or over TCP on this machine",
        )
    import serial

    board_end = -1
    host_end = -1
    try:
        board_end, host_end = os.openpty()
        with serial.Serial(os.ttyname(host_end), BAUD, timeout=1.0) as port:
            os.write(board_end, b"heli")
            if port.read(4) != b"heli":
                return Finding(Verdict.BAD, "a pseudo-terminal loses bytes", "restart this computer")
    except (OSError, serial.SerialException, ValueError) as error:
        return Finding(
            Verdict.BAD,
            f"pseudo-terminals at {BAUD} baud do not work: {error}",
            "mount /dev/pts (in a container: start it with a terminal), or simulate with --speed max",
        )
    finally:
        for descriptor in (board_end, host_end):
            if descriptor >= 0:
                os.close(descriptor)
    return Finding(Verdict.GOOD, f"pseudo-terminals work, at {BAUD} baud too")
