"""The verbs that find, check, test and flash a board: ``ports``, ``doctor``, ``motors`` and ``flash``."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.data.files import write_signed
from heli_host.ui.cli.board import (
    ARDUINO_VIDS,
    board_text,
    board_versions,
    check_target,
    clear_latched_fault,
    is_due,
    is_due_native,
    open_board,
)
from heli_host.ui.cli.doctor import Verdict, check_modem_manager, examine
from heli_host.ui.cli.options import (
    ClearFaultOption,
    JsonOption,
    PortOption,
    RigOption,
    SilOption,
    SpeedOption,
    sil_address,
)
from heli_host.ui.cli.say import say, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.board.flashing import Bossac
    from heli_host.board.heli import Heli
    from heli_host.errors import LinkVersionMismatch

MAX_S = 30.0
# The board switches the motors off if no open-loop message arrives for setpoint_hold_s (0.5 s).
REFRESH_S = 0.1
ANSWER_TIMEOUT_S = 5.0
"""Longest wait for the board's welcome, before and after; a Due takes up to 3 s after its port was opened."""


def ports(json: JsonOption = None) -> None:
    """List the serial ports, the Due's programming port first.

    Opens no port, so that no board is reset.

    Example: `heli-host ports`
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from heli_host.errors import printable
    from heli_host.link.transport import available_ports

    available = sorted(available_ports(), key=is_due, reverse=True)
    entries = [
        {
            "device": port.device,
            "description": port.description,
            "stable_name": port.stable_name,
            "due": is_due(port),
            "due_native": is_due_native(port),
        }
        for port in available
    ]
    if write_result(json, {"ports": entries}):
        return
    console = Console(highlight=False)
    if not available:
        console.print("no serial port; plug the board in by its programming port, next to the power jack")
        return
    table = Table("port", "what", "name that stays", box=None, pad_edge=False)
    for port in available:
        # pyserial describes a port without a description as "n/a".
        description = port.description if port.description != "n/a" else "serial port"
        if is_due(port):
            description = "Arduino Due, programming port"
        elif is_due_native(port):
            description = "Arduino Due, native port: use the other one"
        stable_name = port.stable_name if port.stable_name != port.device else ""
        table.add_row(*(Text(printable(cell)) for cell in (port.device, description, stable_name)))
    console.print(table)


def doctor(json: JsonOption = None) -> None:
    """Check this computer, and print how to fix each problem.

    Checks Python, packages, compiler, serial ports and ModemManager. Opens no port. The exit code is 1 if
    something required does not work.

    Example: `heli-host doctor`
    """
    from rich.console import Console
    from rich.markup import escape

    from heli_host.errors import printable

    if json is not None:
        rows = [{**asdict(finding), "verdict": finding.verdict.value} for finding in examine()]
        bad_count = sum(row["verdict"] == Verdict.BAD.value for row in rows)
        write_result(json, {"ready": not bad_count, "findings": rows})
        raise typer.Exit(1 if bad_count else 0)
    mark_of_verdict = {Verdict.GOOD: "[green]✓[/]", Verdict.NOTE: "[yellow]–[/]", Verdict.BAD: "[red]✗[/]"}
    console = Console(highlight=False, soft_wrap=True)
    bad_count = 0
    for finding in examine():
        console.print(f"{mark_of_verdict[finding.verdict]} {escape(printable(finding.what))}")
        if finding.remedy:
            console.print(f"    {escape(printable(finding.remedy))}")
        bad_count += finding.verdict is Verdict.BAD
    if bad_count:
        console.print(f"{bad_count} problem{'s' if bad_count > 1 else ''} to fix, see ✗ above")
        raise typer.Exit(1)
    console.print("ready to fly")


def motors(
    front_V: Annotated[
        float, typer.Option("--front-V", metavar="V", help="Drive the front motor with this voltage.")
    ] = 0.0,
    back_V: Annotated[
        float, typer.Option("--back-V", metavar="V", help="Drive the back motor with this voltage.")
    ] = 0.0,
    duration_s: Annotated[
        float, typer.Option("--duration", metavar="S", min=0.1, max=MAX_S, help="Drive for this time in s.")
    ] = 2.0,
    clear_fault: ClearFaultOption = False,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
) -> None:
    """Drive the motors with fixed voltages on the bench, then switch them off.

    This enables the drivers of a real board. Use no propellers before docs/how-to/first-power-up.md allows
    them, because nothing holds the arm. Without voltages it only enables the drivers. Ctrl-C switches off
    immediately. The board itself switches off if this program ends.

    Example: `heli-host motors --port /dev/ttyACM0 --front-V 1.0 --duration 2`
    """
    from heli_host.board.flying import check_voltages

    with open_board(port, sil_address(rig=rig, speed=speed) if sil else None) as heli:
        if clear_fault:
            clear_latched_fault(heli)
        check_voltages(front_V, back_V, heli.params)
        heli.arm()
        try:
            _apply_voltages(heli, front_V, back_V, duration_s)
        finally:
            heli.stop()
        say(f"front {front_V:g} V, back {back_V:g} V for {duration_s:g} s; drivers off again")


def _apply_voltages(heli: Heli, front_V: float, back_V: float, duration_s: float) -> None:
    """Apply constant motor voltages for a time, by a command every `REFRESH_S`, because the board switches
    the motors off without one.
    """
    from heli_host.declaration import Axes, State
    from heli_host.errors import CommandRefused, FlightAborted, fault_text

    for _ in heli.pace(REFRESH_S, duration_s):
        try:
            heli.control(Axes(0), front_V, back_V)
        except CommandRefused as refused:
            # Telemetry reports the kind of fault slightly later.
            heli.wait(REFRESH_S)
            if heli.state is not State.FAULT:
                raise
            raise FlightAborted(f"the board switched the motors off: {fault_text(heli.fault)}") from refused


def flash(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.bin", help="Write this image, such as build/pio/due/firmware.bin.")
    ],
    port: PortOption = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Erase without a question.")] = False,
    discard_parameters: Annotated[
        bool,
        typer.Option("--discard-parameters", help="Erase even saved parameters that this host cannot read."),
    ] = False,
    bossac: Annotated[
        Path | None,
        typer.Option(
            "--bossac",
            metavar="PROGRAM",
            help="Use this uploader.  [default: the best one that is installed]",
        ),
    ] = None,
) -> None:
    """Erase a Due, write a firmware image into it, and verify it.

    Checks the image first, and asks before it erases. Erasing deletes the board's saved parameters. They are
    saved in parameters-TIME.toml first, for `heli-host params restore`. If this host cannot read them, it
    erases nothing. Afterwards the board must answer with the new firmware.

    This has been tested with a simulated uploader and board only.

    Example: `heli-host flash build/pio/due/firmware.bin --port /dev/ttyACM0`
    """
    from heli_host.board.flashing import erase_chip, find_bossac, read_image, restart_chip, write_image
    from heli_host.declaration import LINK_HASH

    image = read_image(file)
    say(f"{file}: {len(image.content)} bytes, firmware for the Due, link {LINK_HASH:08x}")
    uploader = find_bossac(bossac)
    check_target(port, sil=None)
    assert port is not None  # checked by `check_target`, because nothing is simulated
    if "://" in port:
        raise typer.BadParameter(
            f"{port} is not a serial port of this computer; give one, such as /dev/ttyACM0"
        )
    if uploader.is_doubtful:
        say(f"note: {_uploader_warning(uploader)}")
    manager = check_modem_manager(_vendors(port))
    if manager.verdict is Verdict.BAD:
        say(f"note: {manager.what}; {manager.remedy}")

    saved_parameters = _keep_parameters(port, discard_parameters)
    if not yes:
        if not sys.stdin.isatty():
            raise typer.BadParameter(
                "standard input is not a terminal, so erasing cannot be confirmed; add --yes"
            )
        typer.confirm("This erases the whole flash, the saved parameters too. Go on?", abort=True)

    say(f"erasing the board on {port}")
    erase_chip(port)
    say(f"writing and verifying with bossac {uploader.version}")
    write_image(uploader, port, file)
    restart_chip(port)
    say(f"flashed: {_description_of_board(port, uploader)}")
    if saved_parameters is not None:
        say(
            f"its parameters are the defaults; yours: heli-host params restore {saved_parameters} --save "
            f"--port {port}"
        )


def _uploader_warning(uploader: Bossac) -> str:
    """Return a warning about an uploader that does not suit all Dues."""
    from heli_host.board.flashing import GET_BOSSAC

    return (
        f"bossac {uploader.version} is reported to leave some Dues that do not start; "
        f"if yours does not answer afterwards, {GET_BOSSAC}"
    )


def _keep_parameters(port: str, discard: bool) -> Path | None:
    """Write the board's parameters into a file, if it has any that are not the defaults."""
    import heli_host
    from heli_host.errors import FlashError, LinkError, LinkVersionMismatch, PortError, WaitTimeout

    try:
        heli = heli_host.connect(port, handshake_timeout_s=ANSWER_TIMEOUT_S)
    except PortError:
        raise
    except LinkVersionMismatch as mismatch:
        say(f"found: {mismatch.cause}")
        return _keep_parameters_of_other_link(port, mismatch, discard)
    except (LinkError, WaitTimeout) as error:
        say(f"no parameters could be read: {error.cause}")
        return None
    if heli.motors_may_run:
        # Another program flies it. The end of a `with` block would land it.
        state = heli.state.name.lower()
        heli.session.close()
        raise FlashError(f"the board on {port} is {state}", "land first, or stop the motors")
    with heli:
        say(f"found: {board_text(heli)}")
        return _write_parameters(heli.params.dump(), board_versions(heli.info))


def _keep_parameters_of_other_link(port: str, mismatch: LinkVersionMismatch, discard: bool) -> Path | None:
    """Do the same for a board whose link version is not this host's."""
    from heli_host.board.flashing import saved_parameters
    from heli_host.errors import FlashError
    from heli_host.link.transport import open_transport

    transport = open_transport(port)
    try:
        values = saved_parameters(transport, ANSWER_TIMEOUT_S)
    except FlashError as error:
        if not discard:
            raise
        say(f"discarded: {error.cause}")
        return None
    finally:
        transport.close()
    return _write_parameters(values, f"firmware {mismatch.firmware_version}, link {mismatch.board_version}")


def _write_parameters(values: dict[str, float], origin: str) -> Path | None:
    """Write a board's parameters to a file with the time in its name, and return the file; None if all are
    defaults.
    """
    from heli_host.board.parameters import parameters_text, spec_of

    if all(
        abs(value - spec_of(name).default) <= 1e-6 * max(1.0, abs(value)) for name, value in values.items()
    ):
        print("its parameters are the defaults: there is nothing to keep")
        return None
    file = Path(time.strftime("parameters-%Y-%m-%d_%H-%M-%S.toml"))
    write_signed(file, parameters_text(values, origin))
    say(f"its {len(values)} parameters -> {file}")
    return file


def _description_of_board(port: str, uploader: Bossac) -> str:
    """Return a description of the board that now answers."""
    import heli_host
    from heli_host.errors import FlashError, HandshakeTimeout, WaitTimeout, WrongDevice

    try:
        with heli_host.connect(port, handshake_timeout_s=ANSWER_TIMEOUT_S) as heli:
            return board_text(heli)
    except (HandshakeTimeout, WrongDevice, WaitTimeout) as error:
        remedy = (
            "press RESET on the board, then heli-host watch; if it stays silent, see docs/how-to/flashing.md"
        )
        if uploader.is_doubtful:
            remedy = f"{_uploader_warning(uploader)}; {remedy}"
        raise FlashError(
            f"the flash was written and verified, but the board does not answer ({error.cause})", remedy
        ) from error


def _vendors(port: str) -> set[int]:
    """Return the USB number of the vendor of the board at `port`; that of most boards if it is unknown."""
    from heli_host.link.transport import available_ports

    known = {
        known.vendor_id
        for known in available_ports()
        if port in (known.device, known.stable_name) and known.vendor_id is not None
    }
    return known or {ARDUINO_VIDS[0]}


VERBS = {verb.__name__: Verb(verb, "Board") for verb in (doctor, flash, motors, ports)}
