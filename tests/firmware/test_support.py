"""The few functions that stand in for newlib's do the same, byte by byte; run on this machine."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.firmware.built import ROOT

pytestmark = pytest.mark.emulated


@pytest.fixture(scope="module")
def functions(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """memory.cpp as a library; its names get a prefix, for the process has its own."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    folder = tmp_path_factory.mktemp("support")
    memory = (ROOT / "firmware" / "due" / "memory.cpp").read_text()
    renamed = re.sub(r"\b(memcpy|memset|memcmp)\(", r"due_\1(", memory)
    (folder / "memory.cpp").write_text(renamed)
    library = folder / "support.so"
    flags = ["-std=c++17", "-O2", "-shared", "-fPIC", "-fno-tree-loop-distribute-patterns"]
    process = subprocess.run(
        [compiler, *flags, folder / "memory.cpp", "-o", library], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    return ctypes.CDLL(str(library))


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
