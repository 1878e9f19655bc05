"""PlatformIO extra script: the project's own flags instead of the platform's, and bounds on size and stack.

The platform's bare-metal mode brings flags of its own (gnu++11, -Os, Arduino's entry point). All of them go,
so that the real platform, the stand-in and the Makefile of firmware/due compile and link alike.
"""

import os
from pathlib import Path

Import("env", "projenv")  # type: ignore[name-defined]  # noqa: F821 - SCons puts these names here

build = env  # type: ignore[name-defined]  # noqa: F821 - the same
project = projenv  # type: ignore[name-defined]  # noqa: F821 - the same

FIRMWARE = Path(build.subst("$PROJECT_DIR")) / "firmware"
BUILD = Path(build.subst("$BUILD_DIR"))


def flags(name):
    """Return the flags in one of the flag files of firmware/due."""
    return (FIRMWARE / "due" / name).read_text().split()


project.Replace(
    CCFLAGS=flags("compile.flags"),
    CXXFLAGS=[],
    CPPDEFINES=[],
    # The first wiring.hpp is taken: of HELI_WIRING, if build.py has made one from another pins.toml.
    CPPPATH=[*filter(None, [os.environ.get("HELI_WIRING")]), str(FIRMWARE / "core"), str(FIRMWARE / "due")],
)
build.Replace(
    # The g++ driver would ask for libstdc++, which nothing here needs.
    LINK="$CC",
    LINKFLAGS=[
        *flags("link.flags"),
        # Paths are whole words: a path that SCons puts in by itself falls apart at a space.
        f"-T{FIRMWARE / 'due' / 'due.ld'}",
        f"-Wl,-Map={BUILD / 'firmware.map'}",
    ],
    LIBS=["m"],
)
build.AddPostAction(
    "$BUILD_DIR/firmware.elf",
    build.VerboseAction(
        f'"$PYTHONEXE" "{FIRMWARE / "due" / "report.py"}" "$TARGET"', "Size and stack of $TARGET"
    ),
)
