"""Compile the simulated world to WebAssembly by the compiler in PyPI's package ziglang.

Its C++ library for WebAssembly comes without exceptions, which the emulated Due uses in normal flow. The
parts of LLVM's libc++, libc++abi and libunwind that the module needs are in the package, and are compiled
here with exceptions.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
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
_LIBRARY: Final = {
    "libcxx": "memory exception functional hash new new_handler new_helpers optional stdexcept string "
    "vector verbose_abort",
    "libcxxabi": "abort_message cxa_aux_runtime cxa_default_handlers cxa_exception cxa_exception_storage "
    "cxa_guard cxa_handlers cxa_personality cxa_virtual fallback_malloc private_typeinfo stdlib_exception "
    "stdlib_new_delete stdlib_stdexcept stdlib_typeinfo",
}
"""Parts of the C++ library that the module needs. The compiler itself would first build all of it."""
_RUNTIME: Final = (
    *("_LIBCPP_BUILDING_LIBRARY", "_LIBCXXABI_BUILDING_LIBRARY", "LIBCXX_BUILDING_LIBCXXABI"),
    *("_LIBCXXABI_HAS_NO_THREADS", "LIBCXXABI_SILENT_TERMINATE"),
    *("_LIBUNWIND_HIDE_SYMBOLS", "_LIBUNWIND_HAS_NO_THREADS"),
)
"""Macros for these parts."""
_ALONE: Final = "sim/due/chip"
"""Folder of sources that define the same names of registers; other folders are compiled in one piece."""
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
    tag = output.with_name("tag.s")
    tag.write_text(_TAG, encoding="utf-8")
    parts = ("libcxxabi/include", "libcxxabi/src", "libcxx/src", "libunwind/include")
    runtime = (*_TARGET, *_COMMON, "-w", *(f"-I{library / part}" for part in parts))
    runtime += tuple(f"-D{name}" for name in _RUNTIME)
    board = (*_FLAGS, *(f"-I{root / part}" for part in _INCLUDES))
    machine = _TARGET[:3]  # an assembler takes no further flags
    jobs = [(tag, machine), (library / "libunwind/src/Unwind-wasm.c", runtime)]
    for folder, names in _LIBRARY.items():
        files = [library / folder / "src" / f"{name}.cpp" for name in names.split()]
        jobs.append((_together(output, folder, files), (*runtime, "-std=c++23")))
    # Each source reads the same headers, which takes most of the time.
    folders = defaultdict(list)
    for source in sources(root):
        folder = source.parent.relative_to(root).as_posix()
        if folder == _ALONE:
            jobs.append((source, board))
        else:
            folders[folder.replace("/", "_")].append(source)
    jobs += [(_together(output, name, files), board) for name, files in folders.items()]
    objects = [str(output.with_name(f"{number}.o")) for number in range(len(jobs))]

    def compile_source(source: Path, flags: tuple[str, ...], compiled: str) -> None:
        _run("c++" if source.suffix == ".cpp" else "cc", *flags, "-c", str(source), "-o", compiled)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(compile_source, *zip(*jobs, strict=True), objects))
    _run(
        *("c++", *_FLAGS, "-nostdlib++", "-mexec-model=reactor"),
        "-Wl,--export-table,--growable-table,--strip-all,--gc-sections",
        *(*objects, "-o", str(output)),
    )


def _together(output: Path, name: str, files: Sequence[Path]) -> Path:
    """Write a source that includes others."""
    source = output.with_name(f"{name}.cpp")
    source.write_text("".join(f'#include "{file.as_posix()}"\n' for file in files), encoding="utf-8")
    return source


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
    # By content: a checkout of another branch and back changes times, and a compilation takes a minute.
    stamp, digest = output.with_suffix(".sha256"), _digest()
    if output.exists() and stamp.exists() and stamp.read_text() == digest:
        return output
    if importlib.util.find_spec("ziglang") is None:
        raise SimError("the compiler for WebAssembly is missing", "pip install ziglang")
    progress("compiling flight code and emulated Due to WebAssembly; the first time takes a minute")
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
