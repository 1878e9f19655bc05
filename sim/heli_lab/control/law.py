"""A control law, made from a Python function, a gain matrix, a state space, or a CasADi function.

It runs with numpy, over the link, on the board, or as C. `heli_lab.law` has the names for law files.
"""

from __future__ import annotations

import inspect
import linecache
import tempfile
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.board.law_program import LawProgram, check_number, divisor_of
from heli_host.data.arrays import Floats
from heli_host.declaration import AXES, CHANNELS, LAW_INPUTS, LAW_SIGNALS
from heli_host.errors import BadLaw

from heli_lab.control.compile import compile_program
from heli_lab.control.streamed import Streamed

if TYPE_CHECKING:
    import control


_TRUTH: Final = "truth value"
"""Words in CasADi's error message when a symbol is used as a condition."""
SETPOINTS: Final = tuple(f"{axis}_setpoint_rad" for axis in AXES)


@dataclass(frozen=True)
class Command:
    """Result of one call of a law: voltages, new states, signals and setpoints.

    Parameters
    ----------
    front_V, back_V : SX or float
        Motor voltages [V].
    states : mapping of str to SX
        New values of the states by name; states without an entry keep their value.
    signals : mapping of str to SX
        Up to four signals that are logged every tick under their names, in steps of 0.00001 up to 20,000.
    elevation_setpoint_rad, travel_setpoint_rad : SX or float or None
        Setpoints that the law computes, for the log [rad]; None logs the board's setpoints.
    pitch_setpoint_rad : SX or float or None
        Pitch setpoint of the law's inner loop [rad]; None if it has no such loop.
    """

    front_V: Any
    back_V: Any
    states: Mapping[str, Any] = field(default_factory=dict)
    signals: Mapping[str, Any] = field(default_factory=dict)
    elevation_setpoint_rad: Any = None
    pitch_setpoint_rad: Any = None
    travel_setpoint_rad: Any = None


@dataclass(frozen=True)
class Law:
    """A control law: one function that runs with numpy, over the link, on the board, or as C.

    Parameters
    ----------
    name : str
        Name of the law for readers.
    rate_Hz : float
        Calls per second [Hz]: 1000 divided by a whole number.
    function : casadi.Function
        Function of inputs (17), states (n) and parameters (m). It returns outputs (2 voltages, 3 setpoints,
        signals) and new states (n).
    states, parameters : dict of str to float
        Initial values of the states and present values of the parameters, by name.
    signals : tuple of str
        Names of the signals.
    """

    name: str
    rate_Hz: float
    function: ca.Function
    states: dict[str, float] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    signals: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise a BadLaw if a board cannot have this rate, these signals, states or parameters."""
        divisor_of(self.rate_Hz)
        _check_signals(self.signals)
        _check_values("state", self.states, "reduce the order")
        _check_values("parameter", self.parameters, "write as numbers what is not changed in flight")

    @property
    def dt_s(self) -> float:
        """Time from one call to the next [s]."""
        return 1.0 / self.rate_Hz

    @cached_property
    def program(self) -> LawProgram:
        """The law compiled for the board."""
        # BadLaw: No board could run it; the message says why and what to do.
        return compile_program(
            self.function,
            name=self.name,
            rate_Hz=self.rate_Hz,
            states=self.states,
            parameters=self.parameters,
            signals=self.signals,
        )

    @cached_property
    def evaluated(self) -> ca.Function:
        """The function that numpy and C run: limits and conditions return NaN for NaN, as on the board."""
        return _with_nan_propagation(self.function)

    def runner(self) -> Runner:
        """Return the law as a numpy function in double precision, in its initial states."""
        return Runner(self)

    def over_link(self, params: Mapping[str, float]) -> Streamed:
        """Return the law as a controller for `heli_host.Heli.run_controller`.

        Parameters
        ----------
        params : mapping of str to float
            The board's parameters: cut-off frequencies of its rate filters, and limits of its setpoints.
        """
        return Streamed(self.runner(), self.dt_s, params)


class Runner:
    """Runs a law with numpy, one call at a time. `state` has shape (n,)."""

    def __init__(self, law: Law) -> None:
        self.law = law
        self.state: Floats = np.array([*law.states.values()], float)

    def __call__(self, inputs: npt.ArrayLike) -> Floats:
        """Call the law once, and keep its new states. Shapes: `inputs` (17,); returns (5 + signals,)."""
        outputs, state = self.law.evaluated(
            ca.DM(np.asarray(inputs, float)), self.state, [*self.law.parameters.values()]
        )
        self.state = np.asarray(state, float).reshape(-1)
        return np.asarray(outputs, float).reshape(-1)


def control_law(
    *,
    rate_Hz: float = 1000.0,
    states: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    name: str | None = None,
) -> Callable[[Callable[..., Command]], Law]:
    """Make a control law from a Python function; use it as a decorator.

    The function is called once, with symbols: ``now`` has every input by its name (``now.elevation_rad``,
    ``now.travel_setpoint_rad``, ...), ``state`` and ``parameter`` those of the law. It returns a `Command`.

    Parameters
    ----------
    rate_Hz : float
        Calls per second [Hz]: 1000 divided by a whole number.
    states : mapping of str to float, optional
        Initial values, by name, of the states that the law keeps from one call to the next.
    parameters : mapping of str to float, optional
        Values, by name, of the parameters that may be changed in flight.
    name : str, optional
        Name of the law for readers; the function's name by default.

    Returns
    -------
    callable
        Takes the function, returns the `Law`.

    Raises
    ------
    BadLaw
        The function does what no program can, such as a Python ``if`` on a symbol.
    """
    initial_states, parameter_values = dict(states or {}), dict(parameters or {})

    def make(function: Callable[..., Command]) -> Law:
        """Call the function with symbols, and make the law of its result."""
        law_name = name or function.__name__
        input_symbols = ca.SX.sym("inputs", len(LAW_INPUTS))
        state_symbols = ca.SX.sym("states", len(initial_states))
        parameter_symbols = ca.SX.sym("parameters", len(parameter_values))
        now = _namespace_of_symbols(input_symbols, LAW_INPUTS)
        state = _namespace_of_symbols(state_symbols, initial_states)
        parameter = _namespace_of_symbols(parameter_symbols, parameter_values)
        command = _call_with_symbols(function, law_name, now, state, parameter)
        undeclared_states = sorted(set(command.states) - set(initial_states))
        if undeclared_states:
            raise BadLaw(
                f"the law {law_name} has no state {undeclared_states[0]}",
                "name it in states=, with its first value",
            )
        outputs = [
            command.front_V,
            command.back_V,
            *_setpoints_for_log(command, now),
            *command.signals.values(),
        ]
        # A state that the command does not mention keeps its value.
        new_states = [command.states.get(key, getattr(state, key)) for key in initial_states]
        graph = casadi_function(
            input_symbols,
            state_symbols,
            parameter_symbols,
            _scalar_symbols(outputs, law_name),
            _scalar_symbols(new_states, law_name),
        )
        return Law(law_name, rate_Hz, graph, initial_states, parameter_values, tuple(command.signals))

    return make


def _namespace_of_symbols(symbols: ca.SX, names: Iterable[str]) -> SimpleNamespace:
    """Return an object that has the elements of a column of `symbols` as attributes with these `names`."""
    return SimpleNamespace(**{name: symbols[index] for index, name in enumerate(names)})


def _call_with_symbols(
    function: Callable[..., Command],
    law_name: str,
    now: SimpleNamespace,
    state: SimpleNamespace,
    parameter: SimpleNamespace,
) -> Command:
    """Call the user's `function` with symbols."""
    if not _takes_three_arguments(function):
        raise BadLaw(
            f"the law {law_name} does not take three arguments",
            f"write def {law_name}(now, state, parameter):",
        )
    try:
        command = function(now, state, parameter)
    except BadLaw:  # Raised by a function of this module, with an explanation
        raise
    except Exception as error:
        raise _explain_error(error, law_name) from error
    if not isinstance(command, Command):
        raise BadLaw(
            f"the law {law_name} returns {_type_text(command)}",
            "return Command(front_V, back_V, ...): two voltages",
        )
    return command


def _setpoints_for_log(command: Command, now: SimpleNamespace) -> list[Any]:
    """Choose the setpoints of elevation, pitch and travel for the log."""
    defaults = (now.elevation_setpoint_rad, now.pitch_rad, now.travel_setpoint_rad)
    setpoints = []
    for name, default in zip(SETPOINTS, defaults, strict=True):
        value = getattr(command, name)
        setpoints.append(default if value is None else value)
    return setpoints


def _takes_three_arguments(function: Callable[..., Any]) -> bool:
    """Whether a `function` can be called with three positional arguments."""
    try:
        inspect.signature(function).bind(None, None, None)
    except TypeError:  # raised by `bind` if the number does not fit
        return False
    return True


def _scalar_symbols(values: Sequence[Any], name: str) -> list[ca.SX]:
    """Convert outputs of the law `name` to scalar symbols; a BadLaw reports an output of another type or
    size.
    """
    scalars = []
    for output_number, value in enumerate(values):
        try:
            scalar = ca.SX(value)
        # CasADi says of some types that they are not implemented, which is a RuntimeError.
        except (TypeError, RuntimeError) as error:
            raise BadLaw(
                f"output {output_number} of the law {name} has the type {type(value).__name__}",
                "give a number, or an expression of now, state and parameter",
            ) from error
        if scalar.numel() != 1:
            raise BadLaw(
                f"output {output_number} of the law {name} has {scalar.numel()} numbers",
                "give one number per output",
            )
        scalars.append(scalar)
    return scalars


def _explain_error(error: Exception, name: str) -> BadLaw:
    """Explain an `error` in the function of the law `name`: which line, and what to write instead."""
    # The last line outside of CasADi is the user's.
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "casadi" not in frame.filename]
    last_frame = frames[-1] if frames else None
    line_text = f"line {last_frame.lineno} of the law {name}" if last_frame is not None else f"the law {name}"
    source_line = (
        linecache.getline(last_frame.filename, last_frame.lineno or 0).strip()
        if last_frame is not None
        else ""
    )
    if _TRUTH in str(error):
        return BadLaw(
            f"{line_text} uses a symbol as a condition ({source_line})",
            "write if_else(condition, a, b), fmin, fmax or saturated(x, least, most) of heli_lab.law",
        )
    if isinstance(error, AttributeError) and isinstance(error.obj, SimpleNamespace):
        names = ", ".join(vars(error.obj)) or "none, because the law declares none"
        return BadLaw(
            f"{line_text} reads {error.name}, which does not exist ({source_line})", f"names are: {names}"
        )
    # Functions of math convert a symbol to a number, which raises one of these.
    if isinstance(error, TypeError | RuntimeError) and "math." in source_line:
        return BadLaw(
            f"{line_text} calls a function of the module math ({source_line})",
            "use sin, cos, sqrt, ... of heli_lab.law: these accept symbols",
        )
    text = str(error).split("\n")[0]
    return BadLaw(f"{line_text} failed: {type(error).__name__}: {text}", f"correct this line: {source_line}")


def _type_text(value: object) -> str:
    """Describe in a few words what a function returned instead of a Command."""
    if isinstance(value, tuple | list):
        return f"{len(value)} values"
    return f"a value of type {type(value).__name__}"


_MAX_STATES: Final = 255
"""Largest number of states, and of parameters, that a board stores."""
LONGEST_NAME: Final = 63
"""Longest name that MATLAB accepts."""


def _check_signals(signals: Sequence[str]) -> None:
    """Raise a BadLaw if there are too many signals, or if a name cannot be that of a column in a log."""
    if len(signals) > LAW_SIGNALS:
        raise BadLaw(f"{len(signals)} signals are too many", f"give at most {LAW_SIGNALS}")
    reserved = {spec.column for spec in CHANNELS} | {"t_s", "tick"}
    for signal in signals:
        is_name = signal.isidentifier() and signal.isascii() and len(signal) <= LONGEST_NAME
        if not is_name or signal in reserved:
            raise BadLaw(
                f"a signal cannot be named {signal[:LONGEST_NAME]!r}",
                f"give letters, digits and _, at most {LONGEST_NAME}, and not the name of a channel",
            )


def _check_values(kind: str, values: Mapping[str, float], remedy: str) -> None:
    """Raise a BadLaw if there are too many states or parameters, or if a value is not a number of the
    board.
    """
    if len(values) > _MAX_STATES:
        raise BadLaw(
            f"{len(values)} {kind}s are too many for a board", f"give at most {_MAX_STATES}: {remedy}"
        )
    for name, value in values.items():
        check_number(f"{kind} {name}", value)


def casadi_function(
    inputs: ca.SX, states: ca.SX, parameters: ca.SX, outputs: Sequence[ca.SX], new_states: Sequence[ca.SX]
) -> ca.Function:
    """Return the CasADi function of a law, as `Law` describes it, from its symbols and results."""
    return ca.Function(
        "law",
        [inputs, states, parameters],
        [ca.densify(_column_of(outputs)), ca.densify(_column_of(new_states))],
        ["inputs", "states", "parameters"],
        ["outputs", "new_states"],
    )


def _column_of(scalars: Sequence[ca.SX]) -> ca.SX:
    """Return a column of `scalars`, shape (n, 1); n may be 0, which `casadi.vertcat` does not accept."""
    return ca.vertcat(*scalars) if scalars else ca.SX(0, 1)


ERRORS = (*(f"{axis}_rad" for axis in AXES), *(f"{axis}_rad_s" for axis in AXES))
"""States of a gain matrix: angles, then rates, each against its setpoint; pitch's setpoint is level."""


def _tracking_errors(now: Any) -> Any:
    """Return the six `ERRORS` as a column: inputs of a law, `now`, minus their setpoints."""
    errors = []
    for name in ERRORS:
        setpoint_name = name.replace("_rad", "_setpoint_rad", 1)
        setpoint = 0.0 if name.startswith("pitch") else getattr(now, setpoint_name, 0.0)
        errors.append(getattr(now, name) - setpoint)
    return ca.vertcat(*errors)


def from_gain(
    K: npt.ArrayLike, *, hover_V: float, rate_Hz: float = 1000.0, dead_zone_V: float = 1.0, name: str = "gain"
) -> Law:
    """Make a law from a gain matrix: the voltages at hover minus ``K`` times the errors.

    Parameters
    ----------
    K : array_like, shape (2, 6)
        Gains of collective and differential [V] on the errors of elevation, pitch and travel [rad] and of
        their rates [rad/s].
    hover_V : float
        Collective that carries the arm at level, above the dead zones [V].
    rate_Hz : float
        Calls per second [Hz].
    dead_zone_V : float
        Voltage below which a rotor gives no thrust [V].
    name : str
        Name of the law for readers.

    Raises
    ------
    BadLaw
        The matrix has another shape, or holds a value that is not finite.
    """
    shape_text = f"give 2 x {len(ERRORS)} numbers: collective and differential on {', '.join(ERRORS)}"
    try:
        gains = np.asarray(K, float)
    except (TypeError, ValueError) as error:
        raise BadLaw(f"the gain matrix is no array of numbers: {error}", shape_text) from error
    if gains.shape != (2, len(ERRORS)):
        raise BadLaw(f"the gain matrix is {' x '.join(map(str, gains.shape))}", shape_text)
    if not np.isfinite(gains).all():
        row, column = np.argwhere(~np.isfinite(gains))[0]
        raise BadLaw(
            f"the gain of {('collective', 'differential')[row]} on {ERRORS[column]} is {gains[row, column]}",
            "give a finite number; if it was computed, check the design of the gains",
        )

    @control_law(rate_Hz=rate_Hz, name=name, parameters={"hover_V": hover_V})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        """Multiply the errors by the gains, and convert the result to motor voltages."""
        command_V = -ca.mtimes(ca.DM(gains), _tracking_errors(now))
        collective_V, differential_V = parameter.hover_V + command_V[0], command_V[1]
        return Command(*motor_volts(collective_V, differential_V, dead_zone_V))

    return law


_RATE_TOLERANCE: Final = 1e-6
"""Relative difference up to which two rates are equal: an interval in seconds is rounded."""


def from_state_space(
    system: control.StateSpace,
    *,
    hover_V: float,
    rate_Hz: float = 1000.0,
    dead_zone_V: float = 1.0,
    name: str = "state_space",
) -> Law:
    """Make a law from a linear system: from six errors, as in `from_gain`, to collective and differential.

    Parameters
    ----------
    system : control.StateSpace
        Continuous system, which is then sampled by a bilinear transform, or discrete system at `rate_Hz`.
    hover_V, rate_Hz, dead_zone_V : float
        As in `from_gain`.
    name : str
        Name of the law for readers.

    Raises
    ------
    BadLaw
        The system has other inputs or outputs, or was sampled at another rate.
    """
    if (system.noutputs, system.ninputs) != (2, len(ERRORS)):
        raise BadLaw(
            f"the system has {system.ninputs} inputs and {system.noutputs} outputs",
            f"give {len(ERRORS)} inputs ({', '.join(ERRORS)}) and 2 outputs (collective, differential)",
        )
    # In python-control, dt is None if no time is stated, and True for a discrete system of any rate.
    if system.isctime(strict=False):
        system = system.sample(1.0 / rate_Hz, method="bilinear")
    elif system.dt is not True and abs(system.dt * rate_Hz - 1.0) > _RATE_TOLERANCE:
        raise BadLaw(f"the system was sampled every {system.dt:g} s", f"give rate_Hz={1.0 / system.dt:g}")
    A, B, C, D = (ca.DM(np.asarray(matrix)) for matrix in (system.A, system.B, system.C, system.D))
    names = [f"x{k}" for k in range(system.nstates)]

    @control_law(
        rate_Hz=rate_Hz, name=name, states=dict.fromkeys(names, 0.0), parameters={"hover_V": hover_V}
    )
    def law(now: Any, state: Any, parameter: Any) -> Command:
        """Take one step of the state space: compute voltages and new states."""
        x = _column_of([getattr(state, key) for key in names])
        errors = _tracking_errors(now)
        command_V = ca.mtimes(C, x) + ca.mtimes(D, errors)
        next_x = ca.mtimes(A, x) + ca.mtimes(B, errors)
        collective_V, differential_V = parameter.hover_V + command_V[0], command_V[1]
        front_V, back_V = motor_volts(collective_V, differential_V, dead_zone_V)
        return Command(front_V, back_V, states={key: next_x[k] for k, key in enumerate(names)})

    return law


def from_function(
    function: ca.Function,
    *,
    rate_Hz: float = 1000.0,
    states: Sequence[float] = (),
    parameters: Mapping[str, float] | None = None,
    name: str | None = None,
) -> Law:
    """Make a law from a CasADi function.

    Parameters
    ----------
    function : casadi.Function
        Function of inputs (17, as ``LAW_INPUTS``), states (n) and parameters (m). It returns two voltages [V]
        and new states (n). The states and parameters, and the new states, may be missing.
    rate_Hz : float
        Calls per second [Hz].
    states : sequence of float
        Initial values of the states.
    parameters : mapping of str to float, optional
        Names and values of the parameters.
    name : str, optional
        Name of the law for readers; the function's name by default.

    Raises
    ------
    BadLaw
        The function has other arguments or results.
    """
    values = dict(parameters or {})
    expected_sizes = [len(LAW_INPUTS), len(states), len(values)]
    sizes = [function.numel_in(k) for k in range(function.n_in())]
    output_sizes = [function.numel_out(k) for k in range(function.n_out())]
    # States and parameters may be missing among the arguments if the law has none.
    are_arguments_right = sizes == expected_sizes[: len(sizes)] and not any(expected_sizes[len(sizes) :])
    are_results_right = output_sizes == [2, len(states)] or (output_sizes == [2] and not states)
    if not are_arguments_right or not are_results_right:
        raise BadLaw(
            f"the function {function.name()} takes {sizes} and gives {output_sizes} numbers",
            f"write it with {expected_sizes} arguments (inputs, states, parameters) "
            f"and results [2, {len(states)}] (voltages, states)",
        )
    state_names = [f"x{k}" for k in range(len(states))]
    initial_states = dict(zip(state_names, states, strict=True))

    @control_law(rate_Hz=rate_Hz, name=name or function.name(), states=initial_states, parameters=values)
    def law(now: Any, state: Any, parameter: Any) -> Command:
        """Call the CasADi function with columns of symbols."""
        arguments = [
            _column_of([getattr(symbols, key) for key in keys])
            for symbols, keys in ((now, LAW_INPUTS), (state, state_names), (parameter, values))
        ]
        volts, *state_column = function.call(arguments[: len(sizes)])
        # Without states, the function may return voltages alone.
        new_states = {key: state_column[0][k] for k, key in enumerate(state_names)}
        return Command(volts[0], volts[1], states=new_states)

    return law


_BLEND_V = 0.05
"""Lift voltage over which the dead zone is blended in [V]."""


def saturated(value: Any, least: Any, most: Any) -> Any:
    """Limit a `value` to the range from `least` to `most`; each is an SX or a number, in the same unit."""
    return ca.fmin(ca.fmax(value, least), most)


def motor_volts(collective_V: Any, differential_V: Any, dead_zone_V: Any = 1.0) -> tuple[Any, Any]:
    """Convert collective and differential into motor voltages, with the rotors' dead zone (paper, eqs. 31 and
    32).

    Pitch has priority, as in the board's own mixer: if a rotor would have to push down, the collective is
    raised.

    Parameters
    ----------
    collective_V : SX or float
        Front plus back, above the dead zones [V].
    differential_V : SX or float
        Front minus back [V].
    dead_zone_V : SX or float
        Voltage below which a rotor gives no thrust [V].

    Returns
    -------
    tuple of SX
        Front and back voltage [V].
    """
    tilt_V = differential_V / 2
    level_V = ca.fmax(collective_V / 2, ca.fabs(tilt_V))

    def motor(lift_V: Any) -> Any:
        """Add the dead zone to the voltage that lifts."""
        # Near 0 it is added gradually, so that noise does not switch a rotor without lift on and off.
        return ca.fmin(lift_V + dead_zone_V, lift_V * (1.0 + dead_zone_V / _BLEND_V))

    return motor(level_V + tilt_V), motor(level_V - tilt_V)


# Operations that hide NaN in C, with the number of their leading operands that are checked: for a selection,
# only the condition.
_CHECKED_OPERANDS: Final = {
    ca.OP_FMIN: 2, ca.OP_FMAX: 2, ca.OP_LT: 2, ca.OP_LE: 2, ca.OP_EQ: 2, ca.OP_NE: 2, ca.OP_AND: 2,
    ca.OP_OR: 2, ca.OP_NOT: 1, ca.OP_IF_ELSE_ZERO: 1,
}  # fmt: skip


def _with_nan_propagation(function: ca.Function) -> ca.Function:
    """Return the function of a law in which each operation returns NaN if an operand is NaN."""
    function = function.expand() if not function.is_a("SXFunction") else function
    inputs = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    outputs = [ca.SX(function.size1_out(k), 1) for k in range(function.n_out())]
    # Expression in each of CasADi's work registers.
    register: dict[int, ca.SX] = {}
    for k in range(function.n_instructions()):
        code, target = function.instruction_id(k), function.instruction_output(k)
        operands = function.instruction_input(k)
        if code == ca.OP_INPUT:
            number, element = operands
            register[target[0]] = inputs[number][element]
        elif code == ca.OP_CONST:
            register[target[0]] = ca.SX(function.instruction_constant(k))
        elif code == ca.OP_OUTPUT:
            number, element = target
            outputs[number][element] = register[operands[0]]
        else:
            register[target[0]] = _operation_with_nan(code, [register[operand] for operand in operands])
    dense = [ca.densify(output) for output in outputs]
    return ca.Function(function.name(), inputs, dense, function.name_in(), function.name_out())


def _operation_with_nan(code: int, operands: list[ca.SX]) -> ca.SX:
    """Apply CasADi's operation `code`, and make the result NaN if a checked operand is NaN."""
    result = ca.SX.unary(code, *operands) if len(operands) == 1 else ca.SX.binary(code, *operands)
    for operand in operands[: _CHECKED_OPERANDS.get(code, 0)]:
        if not operand.is_constant():
            result = result + _nan_or_zero(operand)
    return result


def _nan_or_zero(value: ca.SX) -> ca.SX:
    """Return an expression that is NaN if a value is NaN, and otherwise 0."""
    # Both comparisons are false for NaN only.
    is_number = ca.logic_or(value < 0.0, value >= 0.0)
    return ca.SX.binary(ca.OP_IF_ELSE_ZERO, ca.logic_not(is_number), value)


def c_source(law: Law) -> str:
    """Return the law as C: CasADi's function ``law`` in single precision, with a comment on its arguments."""
    lines = [
        f"/* {law.name}: a control law, called {law.rate_Hz:g} times a second.",
        "   int law(const float** arg, float** res, long long* iw, float* w, int mem);",
        f"   arg[0], inputs: {', '.join(LAW_INPUTS)}",
        f"   arg[1], states, first values: {_names_and_values(law.states)}",
        f"   arg[2], parameters: {_names_and_values(law.parameters)}",
        f"   res[0]: front_V, back_V, three setpoints in rad{''.join(f', {name}' for name in law.signals)}",
        "   res[1]: new states */",
    ]
    generator = ca.CodeGenerator("law.c", {"casadi_real": "float", "with_header": False})
    generator.add(law.evaluated)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(f"{folder}/")
        body = (Path(folder) / "law.c").read_text(encoding="utf-8")
    return "\n".join(lines) + "\n" + body


def _names_and_values(values: dict[str, float]) -> str:
    """Write named values into one line of a comment."""
    return ", ".join(f"{name} = {value:g}" for name, value in values.items()) or "none"
