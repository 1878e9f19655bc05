"""All errors that this package raises on purpose. Errors of other packages derive from `HeliError` too.

::

    HeliError                   what is wrong and what to do, in one line; exit code
    ├── LinkError               the serial link
    │   ├── PortError           the port cannot be opened: missing, no permission, busy
    │   ├── BadBaud             a rate that cannot work; 1200 baud would erase a Due
    │   ├── LinkLost            the other end went away: unplugged, closed, powered off
    │   ├── HandshakeTimeout    nothing, or no answer to hello, within the deadline
    │   ├── WrongDevice         bytes arrive, but they are not this link's frames
    │   ├── LinkVersionMismatch host and board were built from different declarations
    │   ├── CommandTimeout      a command was not answered within its deadline
    │   ├── CommandRefused      the board refused: result, fault or parameter, and how to fix it
    │   └── FlashError          the board's flash was not written, or what was written does not run
    ├── ImageError              a file that is not this release's firmware for the Due
    ├── UploaderError           bossac is missing, or cannot be used
    ├── ParameterError          unknown name, value out of range, damaged dump
    ├── RigMismatch             the board's counts or directions contradict the rig that it is said to fly
    ├── SetpointError           a target outside the limits in force on the board
    ├── ControllerError         a Python control law raised, or returned no two finite voltages
    ├── BadLaw              a law that cannot run on a board, or is not written as one
    ├── WaitTimeout             the expected condition did not occur before the timeout
    ├── PlanError               a flight plan that cannot be flown as written
    ├── FlightAborted           a flight ended before its plan did
    ├── FlightDataError         a flight file without the columns or units it needs
    └── LogError                the log file
        ├── TruncatedLog        it ends in the middle of a record; the records before are readable
        └── LogWriteError       it cannot be written: disk full, folder missing, no permission

Other packages add classes to this tree and list them in their ``errors.py``. The simulation adds
``SimError``, and the laboratory derives ``IdentifyError`` from it.

``str(error)`` is always one line: what is wrong, then what to do.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterable
from typing import ClassVar

from heli_host.declaration import FAULTS, PARAMS, Fault, FaultSpec, LawError, MessageId, Param, Result, State

MAX_CHARACTERS = 2000
"""Longest cause and longest instruction: a file may hold a name of a megabyte."""


def install_remedy(extra: str) -> str:
    """Return the command that installs an optional part of the package.

    The package is on no index: an installation by its name could bring a foreign package.

    Parameters
    ----------
    extra : str
        Name of the part, such as ``page``.
    """
    return f"in your checkout of heli-lab, run: pip install -e '.[{extra}]'"


def listening_remedy(error: Exception, option: str) -> str:
    """Return what to do when a program cannot listen on an address, by the reason of the `error`.

    Parameters
    ----------
    option : str
        Option that holds the port, for the message.
    """
    number = getattr(error, "errno", None)
    if number == errno.EADDRINUSE:
        return f"give {option} another port, or 0 for a free one"
    if number in (errno.EACCES, errno.EPERM):
        return f"give {option} a port above 1023"
    if isinstance(error, OverflowError):
        return f"give {option} a port from 0 to 65535"
    return "give an address of this computer, such as 127.0.0.1"


def file_remedy(error: OSError) -> str:
    """Return what to do when a file cannot be read or written, by the reason of the `error`."""
    if error.errno == errno.ENOENT:
        return "check the path"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "change its permissions, or choose another path"
    if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", None)):
        return "free disk space, or choose another disk"
    if error.errno == errno.EFBIG:
        # `heli_host.data.files.read_file` states a limit of reading; the system means the disk.
        is_limit_of_reading = str(error.strerror).startswith("it has more than")
        return "cut it into pieces" if is_limit_of_reading else "choose another disk"
    if error.errno == errno.EISDIR:
        return "give the path of a file"
    if error.errno in (errno.ENOTDIR, errno.EEXIST):
        return "choose another path, because a file has the name of a folder in this one"
    return "check that the path names a readable file on a working disk"


def printable(text: str) -> str:
    """Return a text without characters that could control a terminal.

    Parameters
    ----------
    text : str
        Any text, such as the title of a plan from another person.

    Returns
    -------
    str
        With control and formatting characters as their escapes, and its middle left out where it is longer
        than `MAX_CHARACTERS`.
    """
    if len(text) > MAX_CHARACTERS:
        half = MAX_CHARACTERS // 2
        text = f"{text[:half]} ... {text[-half:]}"
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode("ascii")
        for character in text
    )


def announce(text: str) -> None:
    """Print a line about the motors on standard error immediately: the program may end before its result.

    Parameters
    ----------
    text : str
        State of the motors and its cause, for a person next to the rig.
    """
    print(printable(text), file=sys.stderr, flush=True)


class HeliError(Exception):
    """Base of all errors of this package.

    Parameters
    ----------
    cause : str
        What is wrong, in the user's terms.
    remedy : str
        Instruction that fixes the problem; empty if there is none.
    """

    exit_code: ClassVar[int] = 2
    """Exit code of ``heli-host``: 2 invalid request, 3 link, 4 flight ended early, 5 file."""

    def __init__(self, cause: str, remedy: str = "") -> None:
        self.cause = printable(" ".join(cause.split()))
        self.remedy = printable(" ".join(remedy.split()))
        super().__init__(f"{self.cause}; {self.remedy}" if self.remedy else self.cause)


class LinkError(HeliError):
    """An error of the serial link."""

    exit_code = 3


class PortError(LinkError):
    """The port cannot be opened: missing, without permission, or in use."""


class BadBaud(LinkError):
    """A baud rate that cannot work; 1200 baud would erase a Due."""


class LinkLost(LinkError):
    """The other end went away: unplugged, closed or powered off."""


class HandshakeTimeout(LinkError):
    """Nothing was heard, or hello was not answered, within the deadline."""


class WrongDevice(LinkError):
    """Bytes arrive, but they are not frames of this link.

    Parameters
    ----------
    cause : str
        Description of the bytes that were received.
    remedy : str
        Instruction that fixes the problem.
    byte_count : int
        Number of received bytes that belong to no frame.
    excerpt : bytes
        The last of these bytes.
    """

    def __init__(self, cause: str, remedy: str = "", byte_count: int = 0, excerpt: bytes = b"") -> None:
        self.byte_count = byte_count
        self.excerpt = excerpt
        super().__init__(cause, remedy)


class LinkVersionMismatch(LinkError):
    """Host and board were built from different declarations of the link.

    Parameters
    ----------
    host_version, board_version : str
        Version of the link that each end speaks.
    host_hash, board_hash : int
        Hash of the declaration that each end was built from.
    firmware_version : str
        Version of the flight code on the board.
    """

    def __init__(
        self, host_version: str, host_hash: int, board_version: str, board_hash: int, firmware_version: str
    ) -> None:
        self.host_version = host_version
        self.host_hash = host_hash
        self.board_version = board_version
        self.board_hash = board_hash
        self.firmware_version = firmware_version
        super().__init__(
            f"the board (firmware {firmware_version}) has link version {board_version} ({board_hash:08x}), "
            f"but this host has {host_version} ({host_hash:08x})",
            "flash the firmware of this release, or install the heli_host of the board's release",
        )


class CommandTimeout(LinkError):
    """A command was not answered within its deadline, in spite of retries."""


class CommandRefused(LinkError):
    """The board answered a command with a result other than ok.

    Parameters
    ----------
    command : MessageId or int
        The command refused.
    result : Result or int
        The board's result code.
    detail : int
        The detail byte of the ack: a state, a fault, a parameter or a field, as the result says.
    value : float
        The offending quantity, when the board sends one.

    Attributes
    ----------
    state : State or None
        State in which the command is not allowed.
    fault : Fault or None
        The check that failed.
    parameter : str or None
        The parameter at fault, or the one that sets the limit of the fault.
    """

    def __init__(self, command: int, result: int, detail: int = 0, value: float = 0.0) -> None:
        self.command = command
        self.result = result
        self.detail = detail
        self.value = value
        self.state: State | None = None
        self.fault: Fault | None = None
        self.parameter: str | None = None
        cause, remedy = self._cause_and_remedy()
        super().__init__(f"the board refused {_message_name(command)}: {cause}", remedy)

    def _cause_and_remedy(self) -> tuple[str, str]:
        """Return cause and remedy of a refused command in words, and set the state, fault or parameter that
        it concerns.
        """
        detail = self.detail  # the result defines its meaning
        if self.result == Result.BAD_STATE:
            if detail in State._value2member_map_:
                self.state = State(detail)
            name = self.state.name.lower() if self.state is not None else f"number {detail}"
            unknown = "update heli_host: it does not know this state"
            return f"not allowed in state {name}", _STATE_REMEDIES.get(self.state, unknown)
        if self.result == Result.CHECK_FAILED:
            spec = fault_spec(detail)
            if spec is None:
                return f"pre-flight check {detail} failed", "update heli_host: it does not know this check"
            self.fault, self.parameter = Fault(spec.code), spec.parameter
            limit = f" (limit: {spec.parameter}, now {self.value:.4g})" if spec.parameter else ""
            return f"{spec.name}: {spec.meaning}{limit}", spec.remedy
        if self.result in (Result.OUT_OF_RANGE, Result.UNSAFE_NOW):
            param = PARAMS[detail] if detail < len(PARAMS) else None
            if param is None:
                return (
                    f"parameter {detail} cannot be set",
                    "update heli_host: it does not know this parameter",
                )
            self.parameter = param.name
            if self.result == Result.UNSAFE_NOW:
                return f"{param.name} may only be set while idle", "land first, or stop the motors"
            return f"{param.name} does not take this value", f"give {range_text(Param(detail))}"
        if self.result == Result.BAD_LAW:
            return _cause_and_remedy_of_law(detail, self.value)
        remedy = {
            Result.UNKNOWN_COMMAND: "flash the firmware of this release",
            Result.BAD_LENGTH: "flash the firmware of this release",
            Result.BAD_VALUE: "give a finite number within its range",
            Result.NO_SUCH_PARAMETER: "flash the firmware of this release",
            Result.FLASH_FAILED: "try again; if it fails again, the flash is worn: use another board",
            Result.NO_HANDSHAKE: "connect again: the board was restarted",
            Result.HASH_MISMATCH: "flash the firmware of this release",
        }
        if self.result in Result._value2member_map_:
            known = Result(self.result)
            field = f" (field {detail})" if known is Result.BAD_VALUE else ""
            return known.name.lower() + field, remedy.get(known, "")
        return f"result {self.result}", "update heli_host: it does not know this result"


class FlashError(LinkError):
    """The board's flash was not written, or what was written does not run."""


class ImageError(HeliError):
    """A file that is not this release's firmware for the Due; nothing was erased."""


class UploaderError(HeliError):
    """bossac, which writes the flash, is missing or cannot be used; nothing was erased."""


class ParameterError(HeliError):
    """An unknown parameter, a value out of its range, or a damaged parameter dump."""


class RigMismatch(HeliError):
    """Counts per turn or directions on the board contradict the rig."""


class SetpointError(HeliError):
    """A target outside the limits in force on the board; nothing was sent."""


class ControllerError(HeliError):
    """A Python control law raised, or did not return two finite voltages."""


class BadLaw(HeliError):
    """A law that cannot run on a board, or is not written as one; nothing was sent."""


class WaitTimeout(HeliError):
    """The expected condition did not occur before the timeout."""


class PlanError(HeliError):
    """A flight plan that cannot be flown as it is written."""


class FlightAborted(HeliError):
    """A flight ended before its plan did."""

    exit_code = 4


class FlightDataError(HeliError):
    """A flight file without the columns, the units or the order that it needs."""

    exit_code = 5


def check_choice(name: str, value: object, choices: Iterable[str]) -> None:
    """Refuse a text that is not one of those that an argument takes.

    Parameters
    ----------
    name : str
        Name of the argument.
    value : object
        Text of the caller.
    choices : iterable of str
        Valid texts.

    Raises
    ------
    ParameterError
        The text is none of them.
    """
    listed = tuple(choices)
    if value not in listed:
        raise ParameterError(f"{name} is {value!r}", f"give {' or '.join(map(repr, listed))}")


class LogError(HeliError):
    """An error of a log file."""

    exit_code = 5


class TruncatedLog(LogError):
    """The log ends in the middle of a record; the records before it are readable."""


class LogWriteError(LogError):
    """The log cannot be written: disk full, folder missing, no permission."""


_STATE_REMEDIES: dict[State | None, str] = {
    State.IDLE: "arm first",
    State.ARMED: "start a control mode first, or stop to return to idle",
    State.FAULT: "see which fault it is, remove its cause, then clear the fault",
    State.LANDING: "wait until it has landed",
    State.EMERGENCY_LANDING: "wait until it has landed, then see which fault it was",
    State.HOLD: "send setpoints again, or land",
    State.CLOSED_LOOP: "land first, or stop the motors",
    State.OPEN_LOOP: "land first, or stop the motors",
    State.STREAMED: "land first, or stop the motors",
}


def fault_spec(code: int) -> FaultSpec | None:
    """Return the declaration's row of a fault `code` as sent by the board; None for one that this host does
    not know, and for 0.
    """
    return next((spec for spec in FAULTS if spec.code == code), None)


def fault_text(code: int) -> str:
    """Return one line with the fault of a `code` and what to do about it.

    An example is ``"pitch_limit: pitch beyond its limit (pitch_max_deg); check ..."``.
    """
    if code == Fault.NONE:
        return "no fault"
    spec = fault_spec(code)
    if spec is None:
        return f"fault {code}, unknown to this host; update heli_host"
    limit = f" ({spec.parameter})" if spec.parameter else ""
    return f"{spec.name}: {spec.meaning}{limit}; {spec.remedy}"


def range_text(param: Param) -> str:
    """Return the valid values of a parameter, such as ``"a number from 0 to 20 V/deg"`` or ``"-1 or 1"``."""
    spec = PARAMS[param]
    if spec.integer and spec.nonzero and (spec.min, spec.max) == (-1.0, 1.0):
        return "-1 or 1"
    kind = "a whole number" if spec.integer else "a number"
    zero = ", not 0" if spec.nonzero else ""
    unit = f" {spec.unit}" if spec.unit else ""
    return f"{kind} from {spec.min:g} to {spec.max:g}{unit}{zero}"


def _cause_and_remedy_of_law(code: int, value: float) -> tuple[str, str]:
    """Return cause and remedy of a refused law; the meaning of `value` depends on the error `code`."""
    if code not in LawError._value2member_map_:
        return f"law error {code}", "update heli_host: it does not know this error"
    error = LawError(code)
    remedies = {
        LawError.NOT_LOADED: ("the board has no law", "send one first, because every reset erases it"),
        LawError.FLYING: ("a control law flies", "let the board's own law take over first"),
        LawError.NOT_FLYING: (
            "the board does not hover under its own law",
            "take off first, with all loops closed",
        ),
        LawError.TOO_COSTLY: (f"a call needs {value:.0f} ticks", "lower its rate"),
        LawError.NO_SUCH_PARAMETER: (f"the law has {value:.0f} parameters", "send this law first"),
        LawError.WRONG_HASH: ("the law was damaged during the upload", "send it again"),
        LawError.WRONG_PART: ("a part of the law arrived in the wrong order", "send it again"),
        LawError.INCOMPLETE: ("parts of the law are missing", "send it again"),
    }
    plain = f"{error.name.lower()} ({value:.0f})", "compile the law again with this release"
    return remedies.get(error, plain)


def _message_name(message_id: int) -> str:
    if message_id in MessageId._value2member_map_:
        return MessageId(message_id).name.lower()
    return f"message {message_id}"
