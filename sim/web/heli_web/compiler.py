"""Compile the simulated world to WebAssembly by the compiler in PyPI's package ziglang.

Its C++ library for WebAssembly comes without exceptions, which the emulated Due uses in normal flow. The
three files of LLVM's libc++abi and libunwind that implement them are in the package, and are compiled here.
"""

from __future__ import annotations

import hashlib
import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final, TextIO

from heli_sim.errors import SimError

_ROOT: Final = Path(__file__).resolve().parents[3]
_TARGET: Final = (
    "-target",
    "wasm32-wasi",
    "-mcpu=generic+exception_handling+bulk_memory",
    "-fwasm-exceptions",
)
# No contraction, as in the native build: the numbers must be the same.
_COMMON: Final = ("-O2", "-ffp-contract=off", "-fvisibility=hidden", "-DNDEBUG")
_FLAGS: Final = (*_TARGET, *_COMMON, "-std=c++17", "-fno-access-control", "-w")
_INCLUDES: Final = ("firmware/core", "firmware/proofs", "sim/native", "sim/due_board", "sim/due")
_LEFT_OUT: Final = ("plant_step.cpp", "sim_board.cpp", "module.cpp")
_EXCEPTIONS: Final = (
    "libcxxabi/src/cxa_exception.cpp",
    "libcxxabi/src/cxa_personality.cpp",
    "libunwind/src/Unwind-wasm.c",
)
_TAG: Final = ".globl __cpp_exception\n.tagtype __cpp_exception i32\n__cpp_exception:\n"


def sources(root: Path = _ROOT) -> list[Path]:
    """Return all C++ files of the module."""
    folders = [*(root / "firmware/core").rglob("*.cpp"), *(root / "sim/native").glob("*.cpp")]
    folders += [
        path for part in ("board", "bus", "chip", "cpu") for path in (root / "sim/due" / part).glob("*.cpp")
    ]
    folders += [*(root / "sim/due_board").glob("*.cpp"), *(root / "sim/web/board").glob("*.cpp")]
    return sorted(
        path for path in folders if path.name not in _LEFT_OUT and not path.name.startswith("bind_")
    )


def compile_board(output: Path, root: Path = _ROOT) -> None:
    """Compile flight code, world and emulated Due to the WebAssembly module `output`."""
    import ziglang

    folder = output.parent / "objects"
    folder.mkdir(parents=True, exist_ok=True)
    built = folder / output.name
    _compile(built, root, Path(ziglang.__file__).parent / "lib")
    built.replace(output)


def _compile(output: Path, root: Path, library: Path) -> None:
    """Compile and link the module `output`, next to which its objects are; `library` is ziglang's."""
    build, objects = output.parent, []
    for name in _EXCEPTIONS:
        source = library / name
        objects.append(build / f"{source.stem}.o")
        includes = ("libcxxabi/include", "libcxxabi/src", "libcxx/src", "libunwind/include")
        _run(
            "c++" if source.suffix == ".cpp" else "cc",
            *_TARGET,
            *_COMMON,
            "-w",
            *(f"-I{library / part}" for part in includes),
            *(f"-D{name}" for name in ("_LIBCXXABI_BUILDING_LIBRARY", "_LIBCPP_BUILDING_LIBRARY")),
            *(f"-D{name}" for name in ("_LIBCXXABI_HAS_NO_THREADS", "LIBCXX_BUILDING_LIBCXXABI")),
            *(f"-D{name}" for name in ("_LIBUNWIND_HIDE_SYMBOLS", "_LIBUNWIND_HAS_NO_THREADS")),
            "-c",
            str(source),
            "-o",
            str(objects[-1]),
        )
    tag = build / "tag.s"
    tag.write_text(_TAG, encoding="utf-8")
    objects.append(build / "tag.o")
    _run("cc", *_TARGET[:3], "-c", str(tag), "-o", str(objects[-1]))
    _run(
        "c++",
        *_FLAGS,
        "-mexec-model=reactor",
        "-Wl,--export-table,--growable-table,--strip-all,--gc-sections",
        *(f"-I{root / part}" for part in _INCLUDES),
        *(str(path) for path in (*sources(root), *objects)),
        "-o",
        str(output),
    )


def _run(*arguments: str) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "ziglang", *arguments], capture_output=True, text=True, check=False
    )
    if result.returncode:
        lines = [line for line in result.stderr.splitlines() if "error" in line] or ["no message"]
        raise SimError(f"the compiler for WebAssembly failed: {lines[0]}", "report it")


def is_checkout() -> bool:
    """Whether this package is that of a checkout, with the sources of flight code and emulator."""
    return (_ROOT / "firmware/link.toml").exists()


def built_board(progress: Callable[[str], object]) -> Path:
    """Return the WebAssembly module of this checkout, compiled if its sources have changed."""
    if not is_checkout():
        raise SimError(
            "this package has no WebAssembly module", "build the page in a checkout of the sources: make web"
        )
    output = _ROOT / "build/web/board.wasm"
    output.parent.mkdir(parents=True, exist_ok=True)
    # Of several processes, such as the workers of a test run, the first compiles, and the others wait for it.
    with (output.parent / "lock").open("w") as lock:
        _wait_for(lock)
        return _compiled_once(output, progress)


def _wait_for(lock: TextIO) -> None:
    try:
        import fcntl
    except ImportError:
        return
    fcntl.flock(lock, fcntl.LOCK_EX)


def _compiled_once(output: Path, progress: Callable[[str], object]) -> Path:
    """Return the module, compiled if its sources have changed."""
    # By content: a checkout of another branch and back changes times, and a compilation takes two minutes.
    stamp, digest = output.with_suffix(".sha256"), _digest()
    if output.exists() and stamp.exists() and stamp.read_text() == digest:
        return output
    if importlib.util.find_spec("ziglang") is None:
        raise SimError("the compiler for WebAssembly is missing", "pip install ziglang")
    progress("compiling flight code and emulated Due to WebAssembly; the first time takes two minutes")
    compile_board(output)
    stamp.write_text(digest)
    return output


def _digest() -> str:
    """Return a checksum of all that the module is compiled from, and of this file, which states how."""
    headers = [path for folder in _INCLUDES for path in (_ROOT / folder).rglob("*.hpp")]
    content = hashlib.sha256()
    for path in sorted({*sources(), *headers, Path(__file__).resolve()}):
        content.update(f"{path.relative_to(_ROOT)}\0".encode() + path.read_bytes())
    return content.hexdigest()


if __name__ == "__main__":
    built_board(print)
