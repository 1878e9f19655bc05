"""The board's parameters: by name, as files, their origin after an update, and the gains of the paper."""

from __future__ import annotations

import contextlib
import difflib
import errno
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from heli_host.data.files import TOML_BYTES, decode_text, parse_toml, read_file
from heli_host.declaration import (
    PARAMS,
    PARAMS_HASH,
    ControllerMessage,
    ControllerReadMessage,
    Param,
    ParamsDefaultMessage,
    ParamSetMessage,
    ParamsOriginMessage,
    ParamsOriginReadMessage,
    ParamSpec,
    ParamsSaveMessage,
    ParamsSource,
    Result,
)
from heli_host.errors import CommandRefused, HeliError, LinkError, ParameterError, file_remedy, range_text
from heli_host.link.engine import UNNUMBERED
from heli_host.link.events import BOARD_RESTARTED, LinkEvent
from heli_host.link.session import Session

if TYPE_CHECKING:
    from heli_host.link.session import Session


_INDEX = {spec.name: spec.index for spec in PARAMS}


class Parameters(Mapping[str, float]):
    """The parameters in force on the board, read once and then updated with each change.

    ``heli.params["hover_V"]`` reads, ``heli.params["hover_V"] = 1.5`` sets, and ``save`` stores all values,
    so that they survive a restart of the board.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.revision = 0  # Grows with each change, so that copies of the values notice it
        self._values: list[float] = []
        self._stale = True
        session.subscribe_events(self._take_event)

    def __getitem__(self, name: str) -> float:
        index = spec_of(name).index
        if self._stale:
            self.refresh()
        return self._values[index]

    def __setitem__(self, name: str, value: float) -> None:
        self.set(name, value)

    def __iter__(self) -> Iterator[str]:
        return iter(_INDEX)

    def __len__(self) -> int:
        return len(PARAMS)

    def refresh(self) -> None:
        """Read all parameters from the board again."""
        self._values = [shortest_decimal(value) for value in self._session.read_params()]
        self._stale = False
        self.revision += 1

    def spec(self, name: str) -> ParamSpec:
        """Return the declaration of a parameter: unit, range, default, meaning."""
        return spec_of(name)

    def set(self, name: str, value: float) -> float:
        """Set a parameter in the board's memory, and return the value in force, rounded to single
        precision.
        """
        spec = checked(name, value)
        try:
            ack = self._session.command(ParamSetMessage(UNNUMBERED, spec.index, value))
        except CommandRefused as error:
            if error.result == Result.OUT_OF_RANGE:
                # The value is in the declared range, but this board was built with a smaller range.
                raise ParameterError(
                    f"the board refused {name} = {value:g}",
                    f"heli-host params list {name} --long shows the values that this board takes",
                ) from error
            raise
        in_force = shortest_decimal(ack.value)
        # While stale, nothing is kept: the next read asks the board for all values, with this one.
        if not self._stale:
            self._values[spec.index] = in_force
            self.revision += 1
        return in_force

    def save(self) -> int:
        """Write all parameters to the board's flash, so that they outlast a restart; only while idle. Returns
        the generation of the stored set.
        """
        return round(self._session.command(ParamsSaveMessage(UNNUMBERED)).value)

    def defaults(self) -> None:
        """Put the declared defaults into the board's memory; only while idle; does not save."""
        self._session.command(ParamsDefaultMessage(UNNUMBERED))
        self.refresh()

    def dump(self) -> dict[str, float]:
        """Return all parameters by name, in the declaration's order."""
        self.refresh()
        return dict(self)

    def restore(self, values: Mapping[str, float]) -> dict[str, float]:
        """Set several parameters, and return those that changed, with their new values."""
        # If the board refuses one value, none is changed.
        for name, value in values.items():
            checked(name, value)
        before = self.dump()
        changed: dict[str, float] = {}
        for name, value in values.items():
            if shortest_decimal(value) == before[name]:
                continue
            try:
                changed[name] = self.set(name, value)
            except HeliError:
                with contextlib.suppress(LinkError):
                    for changed_name in changed:
                        self.set(changed_name, before[changed_name])
                raise
        return changed

    def _take_event(self, event: LinkEvent) -> None:
        if event.kind == BOARD_RESTARTED:
            self._stale = True


def spec_of(name: str) -> ParamSpec:
    """Return the declaration of a parameter."""
    if name not in _INDEX:
        similar = difflib.get_close_matches(name, _INDEX, 3)
        hint = f"did you mean {' or '.join(similar)}?" if similar else "heli-host params list shows all"
        raise ParameterError(f"unknown parameter {name}", hint)
    return PARAMS[_INDEX[name]]


def checked(name: str, value: float) -> ParamSpec:
    """Check a value against the declaration; return the parameter's row of the table."""
    spec = spec_of(name)
    is_in_range = (
        math.isfinite(value)
        and spec.min <= value <= spec.max
        and not (spec.nonzero and value == 0.0)
        and not (spec.integer and value != round(value))
    )
    if not is_in_range:
        raise ParameterError(f"{name} = {value:g} is out of range", f"give {_range(spec)}")
    return spec


def _range(spec: ParamSpec) -> str:
    return range_text(Param(spec.index))


def shortest_decimal(value: float) -> float:
    """Return the shortest decimal number that equals `value` in single precision: 0.35, not 0.349999994."""
    return float(str(np.float32(value)))


TABLE = "parameters"
"""Table of the file that holds the values."""
UNITS = "units"
"""Table of the file that holds their units."""
SCHEMA = "schema"
"""Entry of the file with the digest of the parameter schema under which it was written."""
_REMEDY = "give a file that params dump wrote"


def parameters_text(values: Mapping[str, float], comment: str) -> str:
    """Write parameters as TOML that `read_parameter_set` reads."""
    units = {name: spec_of(name).unit for name in values}
    lines = [f"# {comment}", f'{SCHEMA} = "{PARAMS_HASH:08x}"', "", f"[{TABLE}]"]
    for name, value in values.items():
        lines.append(f"{name} = {value!r}" + (f"  # {units[name]}" if units[name] else ""))
    lines += ["", f"[{UNITS}]", *(f'{name} = "{unit}"' for name, unit in units.items())]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class ParameterSet:
    """Parameters of a file, as far as this host's declaration takes them."""

    values: dict[str, float]  # Values by name, in declared units
    dropped: tuple[str, ...]  # One reason per value that is not used
    new: tuple[str, ...]  # Declared parameters that the file does not name


def read_parameter_set(file: Path) -> ParameterSet:
    """Read parameters that may have been written under another schema of the parameters."""
    try:
        content = parse_toml(decode_text(read_file(file, TOML_BYTES)))
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise ParameterError(
                f"{file} is too large for a file of parameters", "give a TOML file of params dump or tune"
            ) from error
        raise ParameterError(f"cannot read {file}: {error.strerror or error}", file_remedy(error)) from error
    except ValueError as error:
        raise ParameterError(f"{file} is not TOML: {error}", _REMEDY) from error
    return parameter_set(content, file)


def parameter_set(content: Mapping[str, object], file: Path) -> ParameterSet:
    """Check the tables of a parameter file."""
    # If the file has this host's schema or no schema, each value must be valid. From a file of another
    # schema, known parameters with the declared unit and a valid value are used, and the others are dropped.
    values = _numbers_by_name(content, file)
    units = content.get(UNITS)
    is_other_schema = content.get(SCHEMA, f"{PARAMS_HASH:08x}") != f"{PARAMS_HASH:08x}"
    accepted: dict[str, float] = {}
    dropped: list[str] = []
    for name, value in values.items():
        try:
            unit = checked(name, value).unit
        except ParameterError as error:
            if not is_other_schema:
                raise
            dropped.append(error.cause)
            continue
        stated_unit = units.get(name, unit) if isinstance(units, dict) else unit
        if is_other_schema and stated_unit != unit:
            dropped.append(f"{name} was in {stated_unit or 'no unit'} and is in {unit or 'no unit'} now")
        else:
            accepted[name] = value
    missing = tuple(spec.name for spec in PARAMS if spec.name not in values)
    return ParameterSet(accepted, tuple(dropped), missing)


def _numbers_by_name(content: Mapping[str, object], file: Path) -> dict[str, float]:
    """Return the numbers of a parameter file by name."""
    table = content.get(TABLE)
    if not isinstance(table, dict) or not table:
        raise ParameterError(f"{file} has no table [{TABLE}]", _REMEDY)
    values: dict[str, float] = {}
    for name, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ParameterError(f"{file}: {name} is not a number", "correct that line")
        values[name] = float(value)
    return values


@dataclass(frozen=True)
class ParameterOrigin:
    """Origin of the parameters on a board: kept, dropped and new ones."""

    source: ParamsSource  # Source of the parameters in force
    kept: int  # Stored values in force
    dropped: int  # Stored values that no parameter takes: unknown, or out of range
    new: tuple[str, ...]  # Parameters at their defaults, because the stored set had no usable value


def read_origin(session: Session) -> ParameterOrigin:
    """Read from the board which of its parameters come from the set that was stored in its flash."""
    answer = ParamsOriginMessage.unpack(session.request(ParamsOriginReadMessage(UNNUMBERED)).payload)
    # One bit per parameter, by its index; each word has 32 of them.
    new_bits = answer.new_0 | answer.new_1 << 32 | answer.new_2 << 64
    return ParameterOrigin(
        source=ParamsSource(answer.source),
        kept=answer.kept,
        dropped=answer.dropped,
        new=tuple(spec.name for spec in PARAMS if new_bits >> spec.index & 1),
    )


def migration_text(origin: ParameterOrigin) -> str:
    """Describe the migration of parameters stored under another schema; empty if there was none."""
    if origin.source is not ParamsSource.MIGRATED:
        return ""
    new = f"{', '.join(origin.new)} at the default" if origin.new else "none new"
    return (
        f"the board saved its parameters under another schema: {origin.kept} kept, {new}, {origin.dropped} "
        "dropped; check them, then heli-host params save"
    )


PAPER_SETS: Final = ("printed", "corrected")
SETS: Final = {"paper": "corrected", "paper-printed": "printed"}
"""Table 6 of the paper under the names that ``--gains`` takes."""

# (34) is three bare PIDs on the error, in degrees and volts. What the board adds to them is set aside: no
# feed-forward but the setpoint's rate (which makes the derivative one of the error), no dead zone, and limits
# that only the supply sets. (34) does not filter its derivative; 20 Hz is the least that 4096 counts allow.
_BARE: Final[Mapping[str, float]] = {
    "dead_zone_V": 0.0,
    "hover_V": 0.0,
    "hover_slope": 0.0,
    "elevation_rate_ff": 1.0,
    "elevation_acceleration_ff": 0.0,
    "pitch_hold_ff": 0.0,
    "travel_rate_ff": 1.0,
    "travel_acceleration_ff": 0.0,
    "elevation_integral_max_V": 20.0,
    "pitch_integral_max_V": 20.0,
    "travel_integral_max_deg": 45.0,
    "elevation_filter_Hz": 20.0,
    "pitch_filter_Hz": 20.0,
    "travel_filter_Hz": 20.0,
    "pitch_setpoint_max_deg": 30.0,
    "differential_max_V": 12.0,
    "pitch_slew_deg_s": 1000.0,
    # Without hover_V and dead zone the integrators wind up to 16 V before the arm lifts, and the printed
    # row of travel swings by 60 degrees: those are no faults of these sets.
    "elevation_motion_V": 40.0,
    "travel_following_max_deg": 90.0,
}
_PITCH: Final = {"pitch_kp": 0.66, "pitch_ki": 3.0, "pitch_kd": 0.1}
_ELEVATION: Final = {"elevation_kp": 0.5, "elevation_ki": 1.0, "elevation_kd": 0.1}
_TRAVEL: Final[Mapping[str, Mapping[str, float]]] = {
    "printed": {"travel_kp": 0.13, "travel_ki": 0.7, "travel_kd": 1.462},
    "corrected": {"travel_kp": 0.7, "travel_ki": 0.13, "travel_kd": 1.462},
}


def paper_gains(which: str) -> dict[str, float]:
    """Return the gains in Table 6 of the paper as parameters of the board, in declared units."""
    # The gains convert errors in degrees to volts; those of travel convert to the pitch setpoint in degrees.
    if which not in _TRAVEL:
        raise ParameterError(f"Table 6 has no set '{which}'", f"give {' or '.join(PAPER_SETS)}")
    return {**_BARE, **_ELEVATION, **_PITCH, **_TRAVEL[which]}


def load_gains(parameters: Parameters, gains: str | None) -> None:
    """Set published `gains`, a name of `SETS`, in the memory of an idle board by its `parameters`; None
    leaves the board's own, and nothing is saved.
    """
    if gains is None:
        return
    for name, value in paper_gains(SETS[gains]).items():
        parameters[name] = value


def controller_names(session: Session) -> tuple[str, ...]:
    """Ask the board for the names of its compiled controllers."""
    # No board has more; a damaged answer must not keep the host asking.
    count = min(_ask_row(session, 0).count, round(PARAMS[Param.CONTROLLER].max) + 1)
    return tuple(controller_name(session, row) for row in range(count))


def controller_name(session: Session, selected: float) -> str:
    """Ask the board for the name of one controller."""
    answer = _ask_row(session, round(selected))
    words = (answer.name_0, answer.name_1, answer.name_2, answer.name_3)
    text = b"".join(word.to_bytes(4, "little") for word in words).rstrip(b"\0")
    return text.decode("ascii", "replace")


def _ask_row(session: Session, row: int) -> ControllerMessage:
    return ControllerMessage.unpack(session.request(ControllerReadMessage(UNNUMBERED, row & 0xFF)).payload)
