"""``heli-host calibrate``: signs, zeros, dead zone and thrust, by hand movements and short pulses."""

from __future__ import annotations

import contextlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final
from urllib.parse import urlencode

import typer
from heli_host.data.files import write_signed
from heli_host.ui.cli.options import (
    DEFAULT_RIG,
    MAX_SPEED,
    ClearFaultOption,
    JsonOption,
    PortOption,
    SilOption,
    flight_folder,
    refuse_without_sil,
    sil_address,
)
from heli_host.ui.cli.say import data_on_stdout, say, say_files, say_progress, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_sim.rig import Rig

    from heli_lab.setup.calibrate.calibration import BenchCalibration
    from heli_lab.setup.calibrate.operator import Operator

_ENCODERS: Final = ("elevation", "pitch", "travel")
_MOTORS: Final = ("front", "back")
_SWAPPED: Final = "swapped"
_WIRES: Final = (*_ENCODERS, *_MOTORS, _SWAPPED)
"""Wires that a simulated rig can have wrong: reversed encoders, reversed motors, exchanged motors."""


def calibrate(
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help="Use this rig for all values that are not measured.  [default: makki2024 with --sil]",
            show_default=False,
        ),
    ] = None,
    save_rig: Annotated[
        Path | None,
        typer.Option(
            "--save-rig",
            metavar="FILE",
            help="Write the calibrated rig to this new file.  [default: RIG-calibrated.toml next to the rig]",
            show_default=False,
        ),
    ] = None,
    save_params: Annotated[
        Path | None,
        typer.Option("--save-params", metavar="FILE", help="Write the board's parameters to this TOML file."),
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            "--log",
            metavar="FILE",
            help="Write the log to this file.  [default: flights/TIME/calibration.mcap]",
            show_default=False,
        ),
    ] = None,
    max_V: Annotated[
        float | None,
        typer.Option(
            "--max-V",
            metavar="V",
            help="Give no pulse above this voltage, at most 6 V.  [default: 1 V above the rig's dead zone]",
            show_default=False,
        ),
    ] = None,
    max_angle_deg: Annotated[
        float,
        typer.Option(
            "--max-angle-deg", metavar="DEG", min=6, max=45, help="Stop if an axis moves further in a pulse."
        ),
    ] = 20.0,
    skip_motors: Annotated[
        bool, typer.Option("--skip-motors", help="Calibrate the encoders only. No motor runs.")
    ] = False,
    clear_fault: ClearFaultOption = False,
    json: JsonOption = None,
    port: PortOption = None,
    sil: SilOption = False,
    miswired: Annotated[
        str,
        typer.Option(
            "--miswired",
            metavar="WIRES",
            help="Simulate wrong wires: elevation, pitch, travel, front, back or swapped.",
        ),
    ] = "",
) -> None:
    """Calibrate a rig on its bench, by hand movements and short pulses.

    Finds zero and direction of each encoder, rotor and direction of each motor, dead zone and thrust. It
    asks before each pulse. Enter, Ctrl-C and the stop switch end a pulse with the motors off. The rig is
    written to a new file. The board is changed only if you confirm it. With --sil, a simulated operator
    moves the rig. See docs/how-to/calibrate.md.

    Example: `heli-host calibrate --port /dev/ttyACM0 --rig mine.toml`
    """
    from heli_host.data.log.disk import check_new
    from heli_host.fly.recorder import Recorder
    from heli_host.ui.cli.board import clear_latched_fault, open_board
    from heli_host.ui.cli.options import check_parameters_place, check_result_places
    from heli_sim.rig import load_rig

    from heli_lab.setup.calibrate.calibration import calibrate as run
    from heli_lab.setup.calibrate.calibration import default_limits

    if not sil:
        refuse_without_sil(miswired=miswired)
        if port is not None and rig is None:
            raise typer.BadParameter(
                "no rig is named, and thrust needs its inertia; add --rig FILE, or --rig makki2024 for the "
                "paper's"
            )
    data_on_stdout(json)
    nominal_rig = load_rig(rig if rig is not None else DEFAULT_RIG)
    new_rig = _new_rig_file(rig, save_rig)
    check_result_places(json)
    check_parameters_place(save_params)
    if log is not None:
        check_new(log)
    limits = replace(default_limits(nominal_rig), max_angle_deg=max_angle_deg)
    if max_V is not None:
        limits = replace(limits, max_V=max_V)
    with contextlib.ExitStack() as stack:
        heli = stack.enter_context(open_board(port, _simulated_board_address(rig, miswired) if sil else None))
        if clear_fault:
            clear_latched_fault(heli)
        operator = _operator_of(heli, simulated=sil)
        path = log if log is not None else flight_folder() / "calibration.mcap"
        recorder = stack.enter_context(Recorder(heli, path, rig_name=nominal_rig.name))
        # The motors stop before the log is closed, however the calibration ends.
        stack.callback(_stop_motors, heli)
        parameters_before = dict(heli.params)

        def mark(part: str) -> None:
            recorder.note("calibrate", part)
            say_progress(f"--- {part}")

        try:
            result = run(
                heli,
                operator,
                nominal_rig,
                limits,
                name=new_rig.stem,
                motors=not skip_motors,
                mark=mark,
                check=recorder.check,
            )
        except BaseException:
            _stop_motors(heli)
            state = "may still run: use the stop switch" if heli.motors_may_run else "are off"
            say(f"the motors {state}; no rig file was written, the log is {path}")
            raise
        _write_files(result, nominal_rig, new_rig, save_params)
        _say_result(result, nominal_rig, parameters_before)
        changed_parameters = {
            name: value for name, value in result.parameters.items() if value != parameters_before[name]
        }
        is_saved = _save_after_question(heli, operator, changed_parameters)
        recorder.note("calibrate", f"parameters {'saved' if is_saved else 'not saved'}: {changed_parameters}")
    say("the board's parameters are saved" if is_saved else "the board's parameters stay as they were")
    result_content = _json_object(result, nominal_rig, parameters_before)
    if not write_result(json, {**result_content, "saved": is_saved, "rig": str(new_rig), "log": str(path)}):
        say_files([new_rig, save_params, path, json])
    if result.motors_exchanged:
        raise typer.Exit(1)


def _new_rig_file(rig: str | None, save_rig: Path | None) -> Path:
    """Return the path of the calibrated rig; a RigError is raised if the file exists."""
    from heli_host.ui.cli.options import check_place
    from heli_sim.errors import RigError

    source = Path(rig if rig is not None else DEFAULT_RIG)
    path = save_rig if save_rig is not None else source.with_name(f"{source.stem}-calibrated.toml")
    check_place(path)
    if path.exists():
        raise RigError(f"{path} exists already", "give another --save-rig, because no rig is overwritten")
    return path


def _simulated_board_address(rig: str | None, miswired: str) -> str:
    """Return the transport address of the simulated board, with wires exchanged as `miswired` lists them."""
    wires = list(filter(None, (word.strip() for word in miswired.split(","))))
    for wire in wires:
        if wire not in _WIRES:
            raise typer.BadParameter(f"unknown --miswired '{wire}'; choose {', '.join(_WIRES)}")
    faults = {
        "encoder_scale": ",".join(f"{wire}:-1" for wire in wires if wire in _ENCODERS),
        "motor_sign": ",".join(f"{wire}:-1" for wire in wires if wire in _MOTORS),
        "motors_swapped": "1" if _SWAPPED in wires else "",
    }
    query = urlencode({key: value for key, value in faults.items() if value})
    return "&".join(filter(None, (sil_address(rig=rig, speed=MAX_SPEED), query)))


def _save_after_question(heli: Heli, operator: Operator, parameters: dict[str, float]) -> bool:
    """Set and save parameters on the board if there are any and the operator agrees; return whether they are
    saved.
    """
    from heli_lab.setup.calibrate.calibration import set_parameters

    if not parameters or operator.choose("Set and save these on the board?", ("yes", "no")) != "yes":
        return False
    set_parameters(heli, operator, parameters)
    return True


def _operator_of(heli: Heli, *, simulated: bool) -> Operator:
    """Return the operator, who moves the axes and answers questions: simulated, or a user at the terminal."""
    import sys

    from heli_sim.sil.inprocess import InProcessTransport

    from heli_lab.setup.calibrate.operator import SimulatedOperator, TerminalOperator

    transport = heli.session.transport
    if simulated and isinstance(transport, InProcessTransport):
        return SimulatedOperator(heli, transport.world, say)
    return TerminalOperator(sys.stdin, say)


def _stop_motors(heli: Heli) -> None:
    """Stop motors that may run; a board that no longer answers is no error here."""
    from heli_host.errors import HeliError

    if heli.motors_may_run:
        with contextlib.suppress(HeliError):
            heli.stop()


def _write_files(result: BenchCalibration, base: Rig, new_rig: Path, save_params: Path | None) -> None:
    """Write the calibrated rig and, if `save_params` is given, the board's parameters."""
    from heli_host.board.parameters import parameters_text
    from heli_sim.rig import write_rig

    write_rig(result.rig, new_rig, f"Written by heli-host calibrate: the rest as {base.name}.")
    if save_params is not None:
        text = parameters_text(result.parameters, "heli-host calibrate: measured on the bench")
        write_signed(save_params, text)


def _say_result(result: BenchCalibration, base: Rig, before: dict[str, float]) -> None:
    """Print each motor's wiring and thrust, each parameter before and after, and the notes."""
    from heli_lab.setup.calibrate.motors import ThrustLine

    say("+- is one standard error")
    for motor in result.motors:
        wiring = "as wired" if motor.sign > 0 else "reversed"
        onset = f"moves pitch from {motor.begins_V:g} V"
        thrust_text = "thrust not known"
        if isinstance(thrust := motor.thrust, ThrustLine):
            thrust_text = (
                f"thrust {thrust.gain_N_per_V:.4g} +- {thrust.gain_std:.2g} N/V above "
                f"{thrust.dead_zone_V:.3g} +- {thrust.dead_zone_std:.1g} V ({thrust.pulses} pulses)"
            )
        say(f"{motor.output} output: {motor.rotor} rotor, {wiring}, {onset}; {thrust_text}")
    for row in _before_and_after(result, base, before):
        change_mark = "" if row["before"] == row["after"] else "  changed"
        before_text, after_text = f"{row['before']:.6g}", f"{row['after']:.6g}"
        say(
            f"{row['of']:<5}  {row['name']:<28} {before_text:>10} -> {after_text:>10} "
            f"{row['unit']}{change_mark}"
        )
    say(*(f"note: {note}" for note in result.notes))


def _before_and_after(result: BenchCalibration, base: Rig, before: dict[str, float]) -> list[dict[str, Any]]:
    """Return the calibrated values of rig and board as JSON objects with the keys of, name, before, after
    and unit.
    """
    from heli_host.board.parameters import spec_of

    from heli_lab.setup.calibrate.calibration import SOURCE

    rig_rows = [
        {
            "of": "rig",
            "name": name,
            "before": base[name].value,
            "after": quantity.value,
            "unit": "" if quantity.unit == "1" else quantity.unit,
        }
        for name, quantity in result.rig.items()
        if quantity.source.startswith(SOURCE)
    ]
    board_rows = [
        {"of": "board", "name": name, "before": before[name], "after": value, "unit": spec_of(name).unit}
        for name, value in result.parameters.items()
    ]
    return [*rig_rows, *board_rows]


def _json_object(result: BenchCalibration, base: Rig, before: dict[str, float]) -> dict[str, Any]:
    """Return the calibration as a JSON object."""
    return {
        "encoders": asdict(result.encoders),
        "motors": [asdict(motor) for motor in result.motors],
        "motors_exchanged": result.motors_exchanged,
        "changes": _before_and_after(result, base, before),
        "notes": list(result.notes),
    }


VERB = Verb(calibrate, "Board")
