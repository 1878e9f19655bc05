"""``heli-host flash``: write a firmware image into the Due."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.data.files import write_signed
from heli_host.ui.cli.options import PortOption
from heli_host.ui.cli.say import say
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.board.flash import Bossac
    from heli_host.errors import LinkVersionMismatch

ANSWER_TIMEOUT_S = 5.0
"""Longest wait for the board's welcome, before and after; a Due takes up to 3 s after its port was opened."""


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
    from heli_host.board.flash import erase_chip, find_bossac, read_image, restart_chip, write_image
    from heli_host.declaration import LINK_HASH
    from heli_host.ui.cli.board import check_target
    from heli_host.ui.cli.finding import Verdict
    from heli_host.ui.cli.modem_manager import check_modem_manager

    image = read_image(file)
    say(f"{file}: {len(image.content)} bytes, firmware for the Due, link {LINK_HASH:08x}")
    uploader = find_bossac(bossac)
    check_target(port, None)
    assert port is not None
    if "://" in port:
        raise typer.BadParameter(
            f"{port} is not a serial port of this computer; give one, such as /dev/ttyACM0"
        )
    if uploader.doubtful:
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
    from heli_host.board.flash.bossac import GET_BOSSAC

    return (
        f"bossac {uploader.version} is reported to leave some Dues that do not start; "
        f"if yours does not answer afterwards, {GET_BOSSAC}"
    )


def _keep_parameters(port: str, discard: bool) -> Path | None:
    """Write the board's parameters into a file, if it has any that are not the defaults."""
    import heli_host
    from heli_host.errors import FlashError, LinkError, LinkVersionMismatch, PortError, WaitTimeout
    from heli_host.ui.cli.board import board_text, board_versions

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
    from heli_host.board.flash import saved_parameters
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
    from heli_host.ui.cli.board import board_text

    try:
        with heli_host.connect(port, handshake_timeout_s=ANSWER_TIMEOUT_S) as heli:
            return board_text(heli)
    except (HandshakeTimeout, WrongDevice, WaitTimeout) as error:
        remedy = (
            "press RESET on the board, then heli-host watch; if it stays silent, see docs/how-to/flashing.md"
        )
        if uploader.doubtful:
            remedy = f"{_uploader_warning(uploader)}; {remedy}"
        raise FlashError(
            f"the flash was written and verified, but the board does not answer ({error.cause})", remedy
        ) from error


def _vendors(port: str) -> set[int]:
    """Return the USB number of the vendor of the board at `port`; that of most boards if it is unknown."""
    from heli_host.link.transport import available_ports
    from heli_host.ui.cli.board import ARDUINO_VIDS

    known = {
        known.vendor_id
        for known in available_ports()
        if port in (known.device, known.stable_name) and known.vendor_id is not None
    }
    return known or {ARDUINO_VIDS[0]}


VERB = Verb(flash, "Board")
