"""The few functions that stand in for libgcc's and newlib's do the same, bit by bit; run on this machine."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.firmware.conftest import ROOT

COMPARISONS: dict[str, Callable[[np.float32, np.float32], bool]] = {
    "__aeabi_fcmpeq": lambda a, b: bool(a == b),
    "__aeabi_fcmplt": lambda a, b: bool(a < b),
    "__aeabi_fcmple": lambda a, b: bool(a <= b),
    "__aeabi_fcmpgt": lambda a, b: bool(a > b),
    "__aeabi_fcmpge": lambda a, b: bool(a >= b),
    "__aeabi_fcmpun": lambda a, b: bool(np.isnan(a) or np.isnan(b)),
}
AWKWARD = [0.0, -0.0, 1.0, -1.0, 1e-45, -1e-45, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan]


@pytest.fixture(scope="module")
def functions(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Both files as a library; the names of memory.cpp get a prefix, for the process has its own."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    folder = tmp_path_factory.mktemp("support")
    memory = (ROOT / "firmware" / "due" / "memory.cpp").read_text()
    renamed = re.sub(r"\b(memcpy|memset|memcmp)\(", r"due_\1(", memory)
    (folder / "memory.cpp").write_text(renamed)
    library = folder / "support.so"
    sources = [folder / "memory.cpp", ROOT / "firmware" / "due" / "soft_compare.cpp"]
    flags = ["-std=c++17", "-O2", "-shared", "-fPIC", "-fno-tree-loop-distribute-patterns"]
    done = subprocess.run(
        [compiler, *flags, *sources, "-o", library], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    loaded = ctypes.CDLL(str(library))
    for name in COMPARISONS:
        getattr(loaded, name).argtypes = [ctypes.c_float, ctypes.c_float]
    return loaded


@pytest.mark.parametrize("name", COMPARISONS)
def test_comparisons_agree_with_ieee_754_on_awkward_values(functions: ctypes.CDLL, name: str) -> None:
    for left in np.array(AWKWARD, dtype=np.float32):
        for right in np.array(AWKWARD, dtype=np.float32):
            assert getattr(functions, name)(left, right) == COMPARISONS[name](left, right), (left, right)


floats = st.floats(width=32)


@given(left=floats, right=floats)
def test_comparisons_agree_with_ieee_754(functions: ctypes.CDLL, left: float, right: float) -> None:
    for name, expected in COMPARISONS.items():
        assert getattr(functions, name)(left, right) == expected(np.float32(left), np.float32(right)), name


@given(data=st.binary(max_size=40), from_offset=st.integers(0, 3), to_offset=st.integers(0, 3))
def test_memcpy_copies_just_what_it_should(
    functions: ctypes.CDLL, data: bytes, from_offset: int, to_offset: int
) -> None:
    source = ctypes.create_string_buffer(b"s" * from_offset + data, 64)
    target = ctypes.create_string_buffer(b"t" * 64, 64)
    functions.due_memcpy(
        ctypes.byref(target, to_offset), ctypes.byref(source, from_offset), ctypes.c_size_t(len(data))
    )
    assert target.raw == b"t" * to_offset + data + b"t" * (64 - to_offset - len(data))


@given(count=st.integers(0, 40), offset=st.integers(0, 3), value=st.integers(0, 255))
def test_memset_sets_just_what_it_should(functions: ctypes.CDLL, count: int, offset: int, value: int) -> None:
    target = ctypes.create_string_buffer(b"t" * 64, 64)
    functions.due_memset(ctypes.byref(target, offset), value, ctypes.c_size_t(count))
    assert target.raw == b"t" * offset + bytes([value]) * count + b"t" * (64 - offset - count)


@given(left=st.binary(min_size=8, max_size=8), right=st.binary(min_size=8, max_size=8))
def test_memcmp_orders_as_bytes_do(functions: ctypes.CDLL, left: bytes, right: bytes) -> None:
    result = functions.due_memcmp(left, right, ctypes.c_size_t(8))
    assert (result > 0) - (result < 0) == (left > right) - (left < right)
