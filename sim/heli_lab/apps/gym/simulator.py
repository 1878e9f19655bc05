"""The rig of an episode, drawn from a domain, and its simulators: the plant alone, or the flight code too."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import urlencode

import casadi as ca
import heli_host
import numpy as np
from heli_host.data.arrays import Floats
from heli_host.declaration import Axes, State
from heli_host.errors import HeliError
from heli_sim.errors import RigError
from heli_sim.evaluate.compiled import compile_function
from heli_sim.model import model_named
from heli_sim.model.effect import Effect
from heli_sim.model.effects import effects_with, parse_effects
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig, write_rig
from heli_sim.rig.rig import count_rad
from heli_sim.sil.inprocess import InProcessTransport
from typing_extensions import override

from heli_lab.errors import LearningError

_MAX_DRAWS: Final = 100
"""Largest number of draws until the parameters form a valid rig; for shipped rigs the first one usually
does."""
_MIN_SHARE: Final = 0.1
"""Smallest drawn value of a parameter that may not be negative, as a share of its nominal value. The
tolerance of some parameters exceeds their value."""


@dataclass(frozen=True)
class EpisodeRig:
    """Rig and effects of one episode."""

    rig: Rig  # The rig with its drawn parameters
    effects: tuple[Effect, ...]  # Effects of the rig file and of the domain
    texts: tuple[str, ...]
    """Effects of the domain in the notation of the command line, such as ``rotor_lag=0.1``."""


@dataclass(frozen=True)
class Domain:
    """Distribution of rigs and effects over episodes; each rig is equally likely.

    Parameters
    ----------
    rigs : tuple of str
        Names or TOML files of rigs.
    tolerances : float
        Scale of the parameters' deviations. With 1, a deviation is normal with half a tolerance of the rig
        file as standard deviation, and is clipped at one tolerance. 0 gives the nominal parameters.
    effects : Mapping of str to (float, float)
        Range of the first parameter of each effect, in its unit; the value is drawn uniformly. An example is
        ``{"rotor_lag": (0.05, 0.15)}``.
    chance : float
        Probability of each effect in an episode, 0 to 1.

    Raises
    ------
    LearningError
        When a scale, a probability or a range is invalid.
    RigError, EffectError
        When a rig or an effect is unknown, or a value of an effect is invalid.
    """

    rigs: tuple[str, ...] = ("makki2024",)
    tolerances: float = 0.0
    effects: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chance: float = 1.0

    def __post_init__(self) -> None:
        if not self.rigs:
            raise LearningError("the domain has no rigs", "give at least one")
        if not (self.tolerances >= 0.0 and 0.0 <= self.chance <= 1.0):
            raise LearningError(
                f"tolerances={self.tolerances} and chance={self.chance} are invalid",
                "give tolerances of 0 or more, and a chance from 0 to 1",
            )
        for name, (low, high) in self.effects.items():
            if not low <= high:
                raise LearningError(
                    f"{name} from {low} to {high} is not a range", "give the smaller value first"
                )
            parse_effects([f"{name}={low!r}"])
            parse_effects([f"{name}={high!r}"])
        for rig in self.rigs:
            load_rig(rig)

    def draw(self, random: np.random.Generator) -> EpisodeRig:
        """Draw the rig and the effects of the next episode with the generator `random`."""
        rig = self._draw_flyable_rig(random)
        texts = tuple(
            f"{name}={float(random.uniform(low, high))!r}"
            for name, (low, high) in self.effects.items()
            if random.random() < self.chance
        )
        return EpisodeRig(rig, effects_with(rig, texts), texts)

    def _draw_flyable_rig(self, random: np.random.Generator) -> Rig:
        """Draw one of the rigs and its parameters; draw again if the parameters do not form a valid rig."""
        rig = load_rig(self.rigs[int(random.integers(len(self.rigs)))])
        if not self.tolerances:
            return rig
        for _ in range(_MAX_DRAWS):
            values = {}
            for name, number in rig.items():
                share = float(np.clip(random.normal() / 2.0, -1.0, 1.0))
                value = number.value + self.tolerances * number.tolerance * share
                values[name] = value if rig.may_be_negative(name) else max(value, _MIN_SHARE * number.value)
            try:
                return rig.replace(**values)
            except RigError:
                continue  # a combination that no rig can have: draw again
        raise LearningError(
            f"no draw of rig '{rig.name}' within {self.tolerances:g} tolerances is valid", "lower tolerances"
        )


_BATCH_TICKS: Final = 4
"""Smallest telemetry batch of the board [ms]: observations are at most 4 ms old."""
_CARRY_S, _CARRY_STEPS = 0.5, 50
"""Time [s] and number of steps in which the arm is moved to its initial state, and again in which it is held
there. The arm then turns at most 20 deg/s, far below the rate at which the board reports a fault."""
_MAX_PLANTS: Final = 32
"""Largest number of compiled plants to keep."""
_ANGLE_LIMITS: Final = ("elevation_min", "elevation_max", "pitch_max", "travel_max")
_LIMITS: Final = (*_ANGLE_LIMITS, "table_damping")
"""Rig parameters that follow those of the model in the arguments of a compiled plant."""
_SETTLING_STEPS, _SETTLING_TICKS = 20, 20
"""Number of steps, and length of each [ms], until lagging thrusts have reached hover: 0.4 s in total."""


@dataclass(frozen=True)
class StepResult:
    """Measurement at the end of a step."""

    angles_rad: Floats  # (3,): Elevation, pitch and travel, quantised by the encoders
    flying: bool = True
    """False if the arm is on its table, an axis is at its stop, or the board refuses voltages."""
    reason: str = ""  # Reason why the flight has ended; empty while it continues


class Simulator(Protocol):
    """Simulation that `HoverEnv` controls."""

    def reset(self, drawn: EpisodeRig, state: Floats, hover_V: Floats, seed: int) -> StepResult:
        """Begin an episode with a rig in the air. Shapes: `state` (6,), `hover_V` (2,)."""

    def step(self, volts_V: Floats, ticks: int) -> StepResult:
        """Apply two voltages for some milliseconds. Shapes: `volts_V` (2,)."""

    def close(self) -> None:
        """Release all resources."""


class PlantAlone(Simulator):
    """Equations of motion with encoders, stops and table, without the board: the fastest simulation."""

    def __init__(self) -> None:
        self._run: dict[object, ca.Function] = {}
        self._plants: dict[object, Plant] = {}

    @override
    def reset(self, drawn: EpisodeRig, state: Floats, hover_V: Floats, seed: int) -> StepResult:
        model = model_named(drawn.rig.model or MultibodyModel.name, drawn.effects)
        delays_s = tuple(effect.values[effect.delay] for effect in drawn.effects if effect.delay)
        # A compiled step depends on these only; all other quantities are its arguments.
        key = (model.name, tuple(effect.name for effect in model.effects), delays_s)
        if key not in self._plants:
            if len(self._plants) >= _MAX_PLANTS:
                self._plants.clear()
                self._run.clear()
            self._plants[key] = Plant(model, drawn.rig, seed)
        plant = self._plants[key]
        self._key, self._plant = key, plant
        # A step takes the parameters of the model, then `_LIMITS`, then those that do not depend on the rig.
        limits = plant.parameters[len(model.parameters) :].copy()
        limits[: len(_LIMITS)] = [drawn.rig[name].value for name in _LIMITS]
        self._parameters = np.array([*model.parameter_values(drawn.rig), *limits])
        self._limits_rad = np.deg2rad([drawn.rig[name].value for name in _ANGLE_LIMITS])
        self._count_rad = count_rad(drawn.rig)
        # Random effects keep their random numbers in the state, so that the seed must be that of the episode.
        seeded = Plant(model, drawn.rig, seed) if plant.extras.random else plant
        self._state = seeded.rest_state()
        # A lagging thrust must start at its hover value.
        for _ in range(_SETTLING_STEPS):
            self._state[:6] = state
            self._advance(hover_V, _SETTLING_TICKS)
        self._state[:6] = state
        return self._measured_result(self._state[:3])

    @override
    def step(self, volts_V: Floats, ticks: int) -> StepResult:
        return self._measured_result(self._advance(np.asarray(volts_V, np.float64), ticks))

    @override
    def close(self) -> None:
        self._plants.clear()
        self._run.clear()

    def _advance(self, volts_V: Floats, ticks: int) -> Floats:
        """Simulate some milliseconds, and return the measured angles [rad], shape (3,)."""
        run = self._function_of_ticks(ticks)
        # CasADi reads and writes the arrays in place; calls with its own matrices take five times as long.
        buffer: Any
        buffer, evaluate = run.buffer()
        after, measured = np.empty(self._state.size), np.empty(3)
        for number, argument in enumerate((self._state, volts_V, self._parameters)):
            buffer.set_arg(number, argument.data)
        for number, result in enumerate((after, measured)):
            buffer.set_res(number, result.data)
        evaluate()
        self._state = after
        return measured

    def _function_of_ticks(self, ticks: int) -> ca.Function:
        """Return a function that simulates some milliseconds in one call; compiled if there is a C
        compiler.
        """
        key = (self._key, ticks)
        if key not in self._run:
            step = self._plant.function
            library = compile_function(step)
            if library is not None:
                step = ca.external(step.name(), str(library))
            start = ca.MX.sym("state", step.numel_in(0))
            volts_V, parameters = ca.MX.sym("volts_V", 2), ca.MX.sym("parameters", step.numel_in(3))
            no_axis_locked = ca.MX.zeros(3)
            state, measured = start, ca.MX.zeros(3)
            for _ in range(ticks):
                state, measured = step(state, volts_V, no_axis_locked, parameters)
            self._run[key] = ca.Function("ticks", [start, volts_V, parameters], [state, measured])
        return self._run[key]

    def _measured_result(self, measured_rad: Floats) -> StepResult:
        """Quantise the measured angles, and find out whether the flight has ended."""
        angles_rad = np.round(measured_rad / self._count_rad) * self._count_rad
        elevation_min, elevation_max, pitch_max, travel_max = self._limits_rad
        elevation, pitch, travel = self._state[:3]
        is_reached = {
            "the arm is on its table": elevation <= elevation_min,
            "elevation is at its stop": elevation >= elevation_max,
            "pitch is at its stop": abs(pitch) >= pitch_max,
            "travel is at its stop": abs(travel) >= travel_max,
        }
        reason = next((limit for limit, reached in is_reached.items() if reached), "")
        return StepResult(angles_rad, not reason, reason)


class BoardInLockstep(Simulator):
    """Flight code with its limits and faults, and the link, in simulated time."""

    def __init__(self) -> None:
        self._heli: heli_host.Heli | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="heli-gym-")
        self._begin: tuple[EpisodeRig, Floats, Floats, int] | None = None
        self._steps: list[tuple[Floats, int]] = []

    def __deepcopy__(self, memo: dict[int, Any]) -> BoardInLockstep:
        """Return another board at the same moment of the same episode."""
        # A running board cannot be copied. In lockstep the same voltages give the same samples, so that the
        # copy flies the episode again from its beginning.
        copied = memo[id(self)] = BoardInLockstep()
        if self._begin is not None and self._heli is not None:
            copied.reset(*self._begin)
            for volts_V, ticks in self._steps:
                copied.step(volts_V, ticks)
        return copied

    @override
    def reset(self, drawn: EpisodeRig, state: Floats, hover_V: Floats, seed: int) -> StepResult:
        self._disconnect()
        self._begin, self._steps = (drawn, state.copy(), hover_V.copy(), seed), []
        self._heli = heli = heli_host.connect(
            self._board_address(drawn, seed), history_s=1.0, land_on_exit=False
        )
        heli.take_off()
        heli.params["telemetry_batch_ticks"] = _BATCH_TICKS
        heli.session.read_interval_s = 0.001
        volts_V = self._clip_to_limits(hover_V)
        # The simulation moves the arm now, and in open loop the board does not check that voltages explain a
        # motion.
        heli.control(Axes(0), *volts_V)
        self._carry_arm(state)
        heli.stream()
        heli.voltages(*volts_V)
        return self._measured_result()

    @override
    def step(self, volts_V: Floats, ticks: int) -> StepResult:
        heli = self._connected_board()
        self._steps.append((np.array(volts_V), ticks))
        try:
            heli.voltages(*self._clip_to_limits(volts_V), valid_s=ticks * 2e-3)
            heli.wait(ticks * 1e-3)
        except HeliError as error:
            return StepResult(self._angles_rad(), flying=False, reason=error.cause)
        return self._measured_result()

    @override
    def close(self) -> None:
        self._disconnect()
        self._folder.cleanup()

    def _board_address(self, drawn: EpisodeRig, seed: int) -> str:
        """Return the address of a simulated board with the episode's rig, which is written to a file."""
        path = Path(self._folder.name) / "rig.toml"
        write_rig(drawn.rig, path)
        options = {"rig": str(path), "seed": str(seed), "slice_ms": "1"}
        if drawn.texts:
            options["effect"] = ";".join(drawn.texts)
        return f"sil://?{urlencode(options)}"

    def _carry_arm(self, state: Floats) -> None:
        """Move the arm to `state`, angles [rad] and rates [rad/s], and hold it until the board's rate filters
        have settled.
        """
        heli = self._connected_board()
        transport = heli.session.transport
        if not isinstance(transport, InProcessTransport):
            raise LearningError("the board runs in another process", "remove the option board")
        world = transport.world
        angles_before_rad = world.state[:3].copy()
        # The arm moves gradually, because the board reports a jump as a runaway axis. A share beyond 1 holds
        # it.
        for share in np.minimum(np.linspace(0.0, 2.0, 2 * _CARRY_STEPS), 1.0):
            angles_rad = angles_before_rad + share * (state[:3] - angles_before_rad)
            world.state = np.array([*angles_rad, *state[3:], *world.state[6:]])
            heli.wait(_CARRY_S / _CARRY_STEPS)

    def _connected_board(self) -> heli_host.Heli:
        """Return the connected board; a LearningError reports that no episode has begun."""
        if self._heli is None:
            raise LearningError("no episode has begun", "call reset() first")
        return self._heli

    def _clip_to_limits(self, volts_V: Floats) -> tuple[float, float]:
        """Limit front and back voltage to the range that the board accepts."""
        params = self._connected_board().params
        front_V, back_V = np.clip(volts_V, params["motor_min_V"], params["motor_max_V"]).tolist()
        return front_V, back_V

    def _angles_rad(self) -> Floats:
        """Return the newest measured angles, shape (3,)."""
        newest = self._connected_board().latest
        return np.array([newest.elevation_rad, newest.pitch_rad, newest.travel_rad])

    def _measured_result(self) -> StepResult:
        """Return the newest measured angles, and whether the board still accepts voltages."""
        newest = self._connected_board().latest
        flying = newest.state is State.STREAMED
        reason = "" if flying else f"the board is in {newest.state}, fault {newest.fault}"
        return StepResult(self._angles_rad(), flying, reason)

    def _disconnect(self) -> None:
        """End the connection to the board, if there is one."""
        if self._heli is not None:
            with contextlib.suppress(HeliError):
                self._heli.close()
            self._heli = None
