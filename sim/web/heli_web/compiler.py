"""Compile the simulated world to WebAssembly by the compiler in PyPI's package ziglang.

Its C++ library for WebAssembly comes without exceptions, which the emulated Due uses in normal flow. The
three files of LLVM's libc++abi and libunwind that implement them are in the package, and are compiled here.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Final

_ROOT: Final = Path(__file__).resolve().parents[3]
_TARGET: Final = ("-target", "wasm32-wasi", "-mcpu=generic+exception_handling+bulk_memory", "-fwasm-exceptions")
# No contraction, as in the native build: the numbers must be the same.
_COMMON: Final = ("-O2", "-ffp-contract=off", "-fvisibility=hidden", "-DNDEBUG")
_FLAGS: Final = (*_TARGET, *_COMMON, "-std=c++17", "-fno-access-control", "-w")
_INCLUDES: Final = ("firmware/core", "firmware/proofs", "sim/native", "sim/due_board", "sim/due")
_LEFT_OUT: Final = ("plant_step.cpp", "greeting.cpp", "module.cpp")
_EXCEPTIONS: Final = (
    "libcxxabi/src/cxa_exception.cpp",
    "libcxxabi/src/cxa_personality.cpp",
    "libunwind/src/Unwind-wasm.c",
)
_TAG: Final = ".globl __cpp_exception\n.tagtype __cpp_exception i32\n__cpp_exception:\n"


def sources(root: Path = _ROOT) -> list[Path]:
    """Return all C++ files of the module."""
    folders = [*(root / "firmware/core").rglob("*.cpp"), *(root / "sim/native").glob("*.cpp")]
    folders += [path for part in ("board", "bus", "chip", "cpu") for path in (root / "sim/due" / part).glob("*.cpp")]
    folders += [*(root / "sim/due_board").glob("*.cpp"), *(root / "sim/web/board").glob("*.cpp")]
    return sorted(
        path for path in folders if path.name not in _LEFT_OUT and not path.name.startswith("bind_")
    )


def compile_board(output: Path, root: Path = _ROOT) -> None:
    """Compile flight code, world and emulated Due to the WebAssembly module `output`."""
    import ziglang

    library = Path(ziglang.__file__).parent / "lib"
    build = output.parent
    build.mkdir(parents=True, exist_ok=True)
    objects = []
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
    subprocess.run([sys.executable, "-m", "ziglang", *arguments], check=True)


if __name__ == "__main__":
    compile_board(Path(sys.argv[1]))
