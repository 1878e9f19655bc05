"""Limit a process that runs an untrusted file: its time and memory, and no written files, sockets or
processes.

There are two fences. On every system, an audit hook of Python refuses actions with readable reasons. On
Linux, a filter of system calls (seccomp), which no code of the process can remove, refuses them too. Reading
files is allowed.
"""

from __future__ import annotations

import ctypes
import math
import os
import platform
import struct
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from heli_host.data.files import limit_process

_MEMORY_LIMIT_MB: Final = 1024
"""Address space [MB]. A law of the documents takes 170 MB, with scipy and control 330 MB. With less, a file
that imports a large library is refused; with more, thirty files could exhaust the teacher's computer."""
_OPEN_FILES: Final = 64
_WRITES: Final = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND

_REFUSED: Final[Mapping[str, tuple[str, ...]]] = {
    "open a socket": ("socket.",),
    "start a process": (
        *("subprocess.", "os.system", "os.exec", "os.posix_spawn", "os.spawn"),
        *("os.startfile", "os.fork", "pty."),
    ),
    "send a signal": ("os.kill",),
    "delete a file": ("os.remove",),
    "delete a folder": ("os.rmdir",),
    "rename a file": ("os.rename",),
    "make a folder": ("os.mkdir",),
    "make a link": ("os.link", "os.symlink"),
    "write a file": ("os.truncate",),
    "change a file": ("os.chmod", "os.chown", "os.utime", "os.setxattr"),
    "change its limits": ("resource.",),
}
"""Actions that a file may not do, and the beginnings of the audit events that Python raises for them."""


@dataclass(frozen=True)
class FileLimits:
    """Limits of the process that runs a stranger's law file."""

    cpu_s: float  # Processor time [s], rounded up
    memory_MB: int = _MEMORY_LIMIT_MB  # Address space [MB]


def fence_process(limits: FileLimits) -> None:
    """Apply the limits to this process, until it ends."""
    # On systems other than Linux, only the audit hook and the limits that the system offers apply.
    seconds = math.ceil(time.process_time() + limits.cpu_s)
    # SIGXCPU states the reason; a file that ignores it is killed a second later.
    limit_process("CPU", seconds, seconds + 1)
    for kind, limit in (("AS", limits.memory_MB << 20), ("FSIZE", 0), ("NOFILE", _OPEN_FILES), ("CORE", 0)):
        limit_process(kind, limit, limit)
    if sys.platform == "linux":
        _filter_system_calls()
    sys.addaudithook(_refuse_audit_event)


def _refuse_audit_event(event: str, arguments: tuple[Any, ...]) -> None:
    """Raise a PermissionError for an audit event that writes a file, opens a socket or starts a process."""
    if event == "open":
        flags = arguments[2] if len(arguments) > 2 else 0
        if isinstance(flags, int) and flags & _WRITES:
            raise PermissionError("a law's file may not write a file")
        return
    for action, beginnings in _REFUSED.items():
        if event.startswith(beginnings):
            raise PermissionError(f"a law's file may not {action}")


# A filter is a program of the kernel's packet filter (BPF) over struct seccomp_data: number, architecture,
# address, then six arguments of 64 bits, low word first.
_LOAD: Final = 0x20
_EQUAL: Final = 0x15
_AT_LEAST: Final = 0x35
_ANY_BIT: Final = 0x45
_RETURN: Final = 0x06
_ALLOW: Final = 0x7FFF0000
_KILL: Final = 0x80000000
_EPERM: Final = 0x00050001
_ENOSYS: Final = 0x00050026
_NUMBER_AT: Final = 0
_ARCHITECTURE_AT: Final = 4
_ARGUMENT_AT: Final = 16
_ARGUMENT_BYTES: Final = 8
_CLONE_THREAD: Final = 0x10000
_X32: Final = 0x40000000
"""Numbers of a second set of the same calls on x86-64."""

_ARCHITECTURES: Final = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
# Names, then numbers on x86-64 and on aarch64; -1 where the latter has no such call.
_CALLS: Final[dict[str, tuple[int, int]]] = {
    "socket": (41, 198), "socketpair": (53, 199), "connect": (42, 203), "bind": (49, 200),
    "sendto": (44, 206), "sendmsg": (46, 211), "fork": (57, -1), "vfork": (58, -1), "execve": (59, 221),
    "execveat": (322, 281), "kill": (62, 129), "tkill": (200, 130), "tgkill": (234, 131),
    "rt_sigqueueinfo": (129, 138), "rt_tgsigqueueinfo": (297, 240), "pidfd_send_signal": (424, 424),
    "pidfd_open": (434, 434), "pidfd_getfd": (438, 438), "ptrace": (101, 117),
    "process_vm_readv": (310, 270), "process_vm_writev": (311, 271), "creat": (85, -1), "truncate": (76, 45),
    "ftruncate": (77, 46), "fallocate": (285, 47), "mkdir": (83, -1), "mkdirat": (258, 34), "rmdir": (84, -1),
    "unlink": (87, -1), "unlinkat": (263, 35), "rename": (82, -1), "renameat": (264, 38),
    "renameat2": (316, 276), "link": (86, -1), "linkat": (265, 37), "symlink": (88, -1),
    "symlinkat": (266, 36), "mknod": (133, -1), "mknodat": (259, 33), "chmod": (90, -1), "fchmod": (91, 52),
    "fchmodat": (268, 53), "fchmodat2": (452, 452), "chown": (92, -1), "lchown": (94, -1),
    "fchown": (93, 55), "fchownat": (260, 54), "setxattr": (188, 5), "lsetxattr": (189, 6),
    "fsetxattr": (190, 7), "removexattr": (197, 14), "lremovexattr": (198, 15), "fremovexattr": (199, 16),
    "utime": (132, -1), "utimes": (235, -1), "futimesat": (261, -1), "utimensat": (280, 88),
    "mount": (165, 40), "umount2": (166, 39), "chroot": (161, 51), "pivot_root": (155, 41),
    "setns": (308, 268), "unshare": (272, 97), "bpf": (321, 280), "perf_event_open": (298, 241),
    "io_uring_setup": (425, 425), "memfd_create": (319, 279), "memfd_secret": (447, 447),
    "shmget": (29, 194), "msgget": (68, 186), "semget": (64, 190), "mq_open": (240, 180),
    "setrlimit": (160, 164), "setsid": (112, 157), "setpgid": (109, 154), "reboot": (169, 142),
    "setpriority": (141, 140),
}  # fmt: skip
_CLONE: Final = (56, 220)
_CLONE3: Final = (435, 435)
_OPEN: Final = (2, -1)
_OPENAT: Final = (257, 56)
_OPENAT2: Final = (437, 437)
_PRLIMIT: Final = (302, 261)


class _FilterProgram(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_void_p))


def _filter_system_calls() -> None:
    """Install the filter of system calls; on a processor whose calls are unknown here, do nothing."""
    machine = platform.machine()
    if machine not in _ARCHITECTURES:
        return
    program = b"".join(
        struct.pack("<HBBI", line.operation, line.skip_if_true, line.skip_if_false, line.operand)
        for line in _system_call_filter(machine)
    )
    buffer = ctypes.create_string_buffer(program)
    header = _FilterProgram(len(program) // 8, ctypes.addressof(buffer))
    libc = ctypes.CDLL(None, use_errno=True)
    no_new_privileges, set_filter, mode_filter = 38, 22, 2
    if libc.prctl(no_new_privileges, 1, 0, 0, 0) or libc.prctl(
        set_filter, mode_filter, ctypes.byref(header), 0, 0
    ):
        raise OSError(ctypes.get_errno(), "the kernel refuses a filter of system calls")


class _Instruction(NamedTuple):
    """An instruction of a filter. A comparison skips some of the next instructions."""

    operation: int
    operand: int
    skip_if_true: int = 0
    skip_if_false: int = 0


def _system_call_filter(machine: str) -> list[_Instruction]:
    """Write the filter for a processor: a list of instructions of the kernel's packet filter (BPF)."""
    processor_column = list(_ARCHITECTURES).index(machine)
    # The numbers of the calls are those of one architecture; calls of another end the process.
    lines = [
        _Instruction(_LOAD, _ARCHITECTURE_AT),
        _Instruction(_EQUAL, _ARCHITECTURES[machine], skip_if_true=1),
        _Instruction(_RETURN, _KILL),
        _Instruction(_LOAD, _NUMBER_AT),
    ]
    if machine == "x86_64":
        lines += [_Instruction(_AT_LEAST, _X32, skip_if_false=1), _Instruction(_RETURN, _KILL)]

    def on_call(call: tuple[int, int], *instructions: _Instruction) -> None:
        """Add the `instructions` that the filter runs for a system call, if this processor has it."""
        number = call[processor_column]
        if number >= 0:
            lines.append(_Instruction(_EQUAL, number, skip_if_false=len(instructions)))
            lines.extend(instructions)

    def check_flags(call: tuple[int, int], flags_argument: int, bits: int, *, are_required: bool) -> None:
        """Refuse a call whose flags have none of the bits if these are required, or any of them if not."""
        skip_refusal_if_any_bit = _Instruction(
            _ANY_BIT, bits, skip_if_true=int(are_required), skip_if_false=int(not are_required)
        )
        on_call(
            call,
            _Instruction(_LOAD, _ARGUMENT_AT + _ARGUMENT_BYTES * flags_argument),
            skip_refusal_if_any_bit,
            _Instruction(_RETURN, _EPERM),
            _Instruction(_RETURN, _ALLOW),
        )

    for call in _CALLS.values():
        on_call(call, _Instruction(_RETURN, _EPERM))
    # These calls pass a pointer, which a filter cannot follow. If they do not exist (ENOSYS), the C library
    # uses the older calls, whose arguments a filter can read.
    for call in (_CLONE3, _OPENAT2):
        on_call(call, _Instruction(_RETURN, _ENOSYS))
    # Threads are allowed, processes are not; files may be read, not written.
    check_flags(_CLONE, flags_argument=0, bits=_CLONE_THREAD, are_required=True)
    check_flags(_OPEN, flags_argument=1, bits=_WRITES, are_required=False)
    check_flags(_OPENAT, flags_argument=2, bits=_WRITES, are_required=False)
    # prlimit64 with new limits: the pointer to them, argument 2, is not null in one of its halves.
    new_limits_at = _ARGUMENT_AT + _ARGUMENT_BYTES * 2
    on_call(
        _PRLIMIT,
        _Instruction(_LOAD, new_limits_at),
        _Instruction(_EQUAL, 0, skip_if_false=2),
        _Instruction(_LOAD, new_limits_at + _ARGUMENT_BYTES // 2),
        _Instruction(_EQUAL, 0, skip_if_true=1),
        _Instruction(_RETURN, _EPERM),
        _Instruction(_RETURN, _ALLOW),
    )
    lines.append(_Instruction(_RETURN, _ALLOW))
    return lines
