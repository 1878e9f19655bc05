"""A control law, made from a Python function: it runs with numpy, over the link, on the board, or as C."""

from __future__ import annotations

import inspect
import linecache
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Final

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.board.law_program import LawProgram
from heli_host.data.arrays import Floats
from heli_host.declaration import AXES, LAW_INPUTS
from heli_host.errors import BadLaw

from heli_lab.control.law.compile import compile_program
from heli_lab.control.law.law_function import LawFunction, casadi_function
from heli_lab.control.law.nan_propagation import with_nan_propagation
from heli_lab.control.law.streamed import Streamed

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
class Law(LawFunction):
    """A control law: one function that runs with numpy, over the link, on the board, or as C.

    Parameters
    ----------
    name, rate_Hz, function, states, parameters, signals
        As in `LawFunction`.
    """

    @cached_property
    def program(self) -> LawProgram:
        """The law compiled for the board.

        Raises
        ------
        BadLaw
            No board could run it; the message says why and what to do.
        """
        return compile_program(self)

    @cached_property
    def evaluated(self) -> ca.Function:
        """The function that numpy and C run: limits and conditions return NaN for NaN, as on the board."""
        return with_nan_propagation(self.function)

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
    initial, values = dict(states or {}), dict(parameters or {})

    def make(function: Callable[..., Command]) -> Law:
        """Call the function with symbols, and make the law of its result."""
        law_name = name or function.__name__
        inputs = ca.SX.sym("inputs", len(LAW_INPUTS))
        states, parameters = ca.SX.sym("states", len(initial)), ca.SX.sym("parameters", len(values))
        now, state = _namespace_of_symbols(inputs, LAW_INPUTS), _namespace_of_symbols(states, initial)
        command = _call_with_symbols(
            function, law_name, now, state, _namespace_of_symbols(parameters, values)
        )
        unknown = sorted(set(command.states) - set(initial))
        if unknown:
            raise BadLaw(
                f"the law {law_name} has no state {unknown[0]}", "name it in states=, with its first value"
            )
        outputs = [
            command.front_V,
            command.back_V,
            *_setpoints_for_log(command, now),
            *command.signals.values(),
        ]
        new_states = [command.states.get(key, getattr(state, key)) for key in initial]
        graph = casadi_function(
            inputs,
            states,
            parameters,
            _scalar_symbols(outputs, law_name),
            _scalar_symbols(new_states, law_name),
        )
        return Law(law_name, rate_Hz, graph, initial, values, tuple(command.signals))

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
    except BadLaw:
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
    """Choose the setpoints of elevation, pitch and travel for the log.

    A setpoint that the law does not give is the board's, and for pitch the measured angle.
    """
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
    except TypeError:
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
    text = str(error).split("\n")[0]
    if isinstance(error, TypeError | RuntimeError) and "math." in source_line:
        return BadLaw(
            f"{line_text} calls a function of the module math ({source_line})",
            "use sin, cos, sqrt, ... of heli_lab.law: these accept symbols",
        )
    return BadLaw(f"{line_text} failed: {type(error).__name__}: {text}", f"correct this line: {source_line}")


def _type_text(value: object) -> str:
    """Describe in a few words what a function returned instead of a Command."""
    if isinstance(value, tuple | list):
        return f"{len(value)} values"
    return f"a value of type {type(value).__name__}"
