"""Flights with a known truth: simulated with our controller and with those of other courses, and measured."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_lab.setup.guess.motion import Reference, reference_of
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig

from tests.identify.made import flown_by_plan, perturbed

DATA: Final = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured"
EFFECTS: Final = (
    (),
    ("rotor_lag=0.12",),
    ("rotor_lag=0.1", "gyroscopic_torque=0.03"),
    ("rotor_lag=0.08", "cable_spring.travel=0.03"),
)
SIMULATED: Final = len(EFFECTS)


@functools.cache
def simulated(number: int) -> tuple[Flight, Rig]:
    """Fly a rig drawn from the tolerances of makki2024, with the effects of `number`; and what a user knows
    of it, the rig file.
    """
    known = load_rig("makki2024")
    model = MultibodyModel(parse_effects(EFFECTS[number], ()))
    return flown_by_plan(perturbed(number, known), number, "identify", model), known


def measured() -> list[Path]:
    """Files of the measured flights; none where they are not."""
    return sorted(DATA.glob("*.csv.gz"))


@functools.cache
def measured_flight(path: Path) -> tuple[Flight, Rig]:
    """A measured flight, and its rig file."""
    return read_flight(path), load_rig("quanser-course")


CONTROL_s: Final = 0.002
TICKS: Final = 2
"""Milliseconds of the plant per step of the controller."""
_DRAWN: Final = ("thrust_gain", "friction_travel", "friction_elevation", "friction_pitch", "torque_travel")
"""Quantities that differ between rigs of one type; masses would need another bias of the voltages."""
PILOTS: Final = ("rates", "hands off", "travel", "manual")


@dataclass(frozen=True)
class PilotFlight:
    """A flight with the commands before their limit."""

    # `flight`: Encoder angles and the voltages that acted, every 2 ms.
    # `commands_V` (n, 2): Voltages before the limit of the supply [V].
    # `bias_V`: Sum of the voltages that the controller adds to its feedback [V].
    # `rates_rad_s` (n, 3): Rates that the controller used [rad/s].
    # `setpoints_rad` (n, 3): Setpoints of elevation, pitch and travel [rad].

    flight: Flight
    commands_V: Floats
    bias_V: float
    rates_rad_s: Floats
    setpoints_rad: Floats


@functools.cache
def piloted(rig_name: str, pilot: str, seed: int, duration_s: float = 45.0) -> PilotFlight:
    """Fly a rig of the type `rig_name`, drawn from the seed, with a `pilot` of `PILOTS`."""
    random = np.random.default_rng(seed)
    rig = _drawn_rig(load_rig(rig_name), random)
    reference = reference_of(rig)
    model = MultibodyModel(parse_effects((f"rotor_lag={random.uniform(0.05, 0.15):.3f}",), ()))
    plant = Plant(model, rig, seed)
    step = _stepper(plant)
    supply_V = rig["supply"].value
    control = _controller(pilot, reference, random, duration_s)
    count = round(duration_s / CONTROL_s)
    angles, commands, applied = np.zeros((count, 3)), np.zeros((count, 2)), np.zeros((count, 2))
    rates, setpoints = np.zeros((count, 3)), np.zeros((count, 3))
    counts = np.array([reference.counts[axis] for axis in ("elevation", "pitch", "travel")]) / (2.0 * math.pi)
    measured = plant.rest_state()[:3]
    rate = np.zeros(3)
    last = np.round(measured * counts) / counts
    for k in range(count):
        angle = np.round(measured * counts) / counts
        rate = rate + 0.06 * ((angle - last) / CONTROL_s - rate)
        last = angle
        total, difference, setpoint = control(k * CONTROL_s, angle, rate)
        commands[k] = 0.5 * (total + difference), 0.5 * (total - difference)
        low_V = -supply_V if rig_name == "quanser-course" else 0.0
        applied[k] = np.clip(commands[k], low_V, supply_V)
        angles[k], rates[k], setpoints[k] = angle, rate, setpoint
        for _ in range(TICKS):
            measured = step(applied[k])
    # Such a log begins in the air.
    keep = slice(round(4.0 / CONTROL_s) if pilot == "hands off" else 0, None)
    t_s = np.arange(count)[keep] * CONTROL_s
    flight = Flight(t_s - t_s[0], *applied[keep].T, *angles[keep].T)
    return PilotFlight(flight, commands[keep], reference.hover_V, rates[keep], setpoints[keep])


def _drawn_rig(rig: Rig, random: np.random.Generator) -> Rig:
    values = {}
    for name in _DRAWN:
        std = (
            0.05 * rig[name].value
            if name == "thrust_gain"
            else rig[name].tolerance * (0.5 if rig[name].value else 0.1)
        )
        value = rig[name].value + std * float(random.standard_normal())
        values[name] = value if Rig.may_be_negative(name) else abs(value)
    # Flights of such rigs show a pendulum on both axes.
    return rig.replace(**values, L_theta=rig["L_theta"].value + 0.04, L_phi=rig["L_phi"].value + 0.003)


def _stepper(plant: Plant) -> Callable[[Floats], Floats]:
    """One millisecond of the plant, by CasADi's buffers, which save the copies of a plain call."""
    buffer, evaluate = plant.function.buffer()
    state = np.ascontiguousarray(plant.rest_state())
    volts, locked, after, measured = np.zeros(2), np.zeros(3), np.zeros(state.size), np.zeros(3)
    parameters = np.ascontiguousarray(plant.parameters)
    for index, values in enumerate((state, volts, locked, parameters)):
        buffer.set_arg(index, memoryview(values))  # type: ignore[call-arg,arg-type]
    for index, values in enumerate((after, measured)):
        buffer.set_res(index, memoryview(values))  # type: ignore[call-arg,arg-type]

    def step(volts_V: Floats) -> Floats:
        volts[:] = volts_V
        # The arrays and the buffer must live as long as this function.
        evaluate()
        state[:] = after
        return measured.copy()

    step.buffer = buffer, locked, parameters  # type: ignore[attr-defined]
    return step


def _controller(
    pilot: str, reference: Reference, random: np.random.Generator, duration_s: float
) -> Callable[[float, Floats, Floats], tuple[float, float, Floats]]:
    """Give sum and difference of the voltages and the setpoints for time, angles and rates."""
    gain, hover_V = reference.gain, reference.hover_V
    pitch_rad_s, wait_s = random.uniform(2.0, 3.0), random.uniform(0.2, 1.0)
    every_s = random.uniform(3.0, 5.0)
    steps = random.uniform(-1.0, 1.0, (math.ceil(duration_s / every_s) + 1, 3))
    integral = 0.0

    def turn(pitch_setpoint: float, angle: Floats, rate: Floats) -> float:
        wanted = pitch_rad_s**2 * (pitch_setpoint - angle[1]) - 1.6 * pitch_rad_s * rate[1]
        return float(wanted) / gain["pitch"]

    def centre(angle: Floats, rate: Floats) -> float:
        """Pitch that keeps a pilot's arm from turning away for ever."""
        return float(np.clip(-0.06 * angle[2] - 0.35 * rate[2], -0.4, 0.4) * np.sign(gain["travel"]))

    def rates(t_s: float, angle: Floats, rate: Floats) -> tuple[float, float, Floats]:
        level, tilt, _ = steps[int(t_s / every_s)]
        lifted = 0.35 if t_s < wait_s + 1.6 else 0.0
        # A joystick moves elevation now and then; otherwise the sum is minus a gain times the rate.
        moved = 0.12 * level if int(t_s / every_s) % 4 == 2 else 0.0
        total = hover_V + 1.8 / gain["elevation"] * (lifted + moved - rate[0])
        pitch = 0.35 * tilt + centre(angle, rate)
        return total, turn(pitch, angle, rate), np.array([lifted + moved, pitch, 0.0])

    def travel(t_s: float, angle: Floats, rate: Floats) -> tuple[float, float, Floats]:
        nonlocal integral
        aim = math.pi * (int(t_s / 14.0) % 2)
        pitch = float(np.clip(0.35 * (aim - angle[2]) - 0.9 * rate[2], -0.5, 0.5)) * np.sign(gain["travel"])
        high = 0.12 * steps[int(t_s / every_s), 0]
        integral = float(np.clip(integral + CONTROL_s * (high - angle[0]), -0.4, 0.4))
        wanted = 1.6 * (high - angle[0]) + 0.4 * integral - 2.2 * rate[0]
        return (hover_V + wanted / gain["elevation"], turn(pitch, angle, rate), np.array([high, pitch, aim]))

    def manual(t_s: float, angle: Floats, rate: Floats) -> tuple[float, float, Floats]:
        level, tilt, _ = steps[int(t_s / every_s)]
        high, pitch = 0.2 * level, 0.5 * tilt + centre(angle, rate)
        wanted = 5.0 * (high - angle[0]) - 4.0 * rate[0]
        return (
            hover_V + wanted / gain["elevation"],
            3.0 * turn(pitch, angle, rate),
            np.array([high, pitch, 0.0]),
        )

    def hands_off(t_s: float, angle: Floats, rate: Floats) -> tuple[float, float, Floats]:
        # Once in the air, the sum is exactly minus a gain times the rate of elevation.
        total, difference, setpoint = rates(t_s, angle, rate)
        moved = setpoint[0] if t_s > wait_s + 1.6 else 0.0
        return total - 1.8 / gain["elevation"] * moved, difference, setpoint * np.array([0.0, 1.0, 0.0])

    flown = {"rates": rates, "hands off": hands_off, "travel": travel, "manual": manual}
    chosen = flown[pilot]

    def control(t_s: float, angle: Floats, rate: Floats) -> tuple[float, float, Floats]:
        if t_s < wait_s:
            return 0.0, 0.0, np.array([angle[0], 0.0, 0.0])
        return chosen(t_s, angle, rate)

    return control
