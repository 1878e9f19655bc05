"""Hostile laws, and what becomes of the arm when the board takes over from them.

Command line: ``python -m tests.law.hostile FIRST LAST`` flies every law on every rig with these seeds.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import heli_host
import numpy as np
from heli_host.declaration import Flags
from heli_lab.law import (
    Command,
    Law,
    control_law,
    fabs,
    fmax,
    fmin,
    if_else,
    motor_volts,
    saturated,
    sin,
    sqrt,
)

HOVER_V: Final = 1.4
HOVER_V_PER_rad: Final = 3.44
HOSTILE_AFTER_s: Final = 3.0
UNREACHABLE_rad: Final = 0.7

RIGS: Final = {
    "nominal": "",
    "slow rotors": "&effect=rotor_lag=0.12",
    "weak rotors": "&effect=thrust_step.front=-0.1@0.001;thrust_step.back=-0.1@0.001",
}

MIN_deg, MAX_deg = -25.0, 22.0
"""Elevations that the board takes as setpoints."""
# The table is at -25 degrees, the upper stop at +25 (makki2024.toml); where they are is known to a degree.
STOP_deg: Final = 24.0
PITCH_STOP_deg: Final = 50.0
# From lower a law may put the arm on the table: motors off, or lift by bang-bang, on rotors that lag by
# 0.12 s (-12.1, -11.8 and -7.8 degrees in 774 flights).
ROOM_deg: Final = -7.5
# The slowest of the cascade's loops, travel's integral, takes as long to let go: 20 s after a takeover that
# left travel 25 degrees away, 6 are left of them, after 40 s none.
CALM_s: Final = 40.0
LONGEST_s: Final = 40.0
# A law that the guard lets fly: law_envelope of elevation_following_max_deg, and what it goes on in the time
# that the guard allows.
NEAR_deg: Final = 13.0
# Below this, the rotors hardly turn, and the voltage for pitch lifts the arm. Without a law the cascade
# then wanders by up to 6.8 degrees (90 flights of 100 s between -25 and -15). With a setpoint below -22
# degrees, the arm hangs at -22.
LOW_deg: Final = -19.5
LOW_ERROR_deg: Final = 8.0
HANGS_deg: Final = -22.0

Volts = tuple[Any, Any]


@dataclass(frozen=True)
class Good:
    """Outputs of a good law: lift and its difference [V], pitch [rad], motors [V]."""

    collective_V: Any
    differential_V: Any
    pitch_rad: Any
    front_V: Any
    back_V: Any


def follows(now: Any, more_V: Any = 0.0, share: float = 1.0) -> Good:
    """Follow a share of the setpoints of elevation and travel."""
    error_rad = share * now.elevation_setpoint_rad - now.elevation_rad
    hover_V = HOVER_V + HOVER_V_PER_rad * now.elevation_rad
    collective_V = hover_V + more_V + 16.0 * error_rad - 12.0 * now.elevation_rad_s
    pitch_rad = 0.5 * (share * now.travel_setpoint_rad - now.travel_rad) - 2.5 * now.travel_rad_s
    differential_V = 5.0 * (pitch_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s
    return Good(collective_V, differential_V, pitch_rad, *motor_volts(collective_V, differential_V))


Bad = Callable[[Any, Good, Any], Volts]
"""Gives the voltages from the inputs, the outputs of a good law, and the time since the law became hostile
[s], or what `hostile` integrates instead."""


def hostile(
    name: str,
    volts: Bad,
    grows: Callable[[Any], Any] = lambda now: 1.0,
    pitch_setpoint: Callable[[Any, Good, Any], Any] | None = None,
) -> Law:
    """Make a law that follows well for three seconds, then does what ``volts(now, good, grown)`` says."""
    # ``grown`` is then the integral of ``grows(now)``: by default the time [s].

    @control_law(states={"t_s": 0.0, "grown": 0.0}, name=name)
    def law(now: Any, state: Any, parameter: Any) -> Command:
        good = follows(now)
        bad = volts(now, good, state.grown)
        late = state.t_s > HOSTILE_AFTER_s
        front_V, back_V = (
            if_else(late, worse, other) for worse, other in zip(bad, (good.front_V, good.back_V), strict=True)
        )
        grown = if_else(late, state.grown + 1e-3 * grows(now), 0.0)
        wanted = None
        if pitch_setpoint is not None:
            wanted = if_else(late, pitch_setpoint(now, good, state.grown), good.pitch_rad)
        states = {"t_s": state.t_s + 1e-3, "grown": grown}
        return Command(front_V, back_V, states=states, pitch_setpoint_rad=wanted)

    return law


def no_number(now: Any) -> Any:
    """Take a root that there is not."""
    return sqrt(-1.0 - fabs(now.pitch_rad))


def lifted(change_V: Callable[[Any, Any], Any]) -> Bad:
    """Change the collective by ``change_V(now, grown)``."""
    return lambda now, good, grown: motor_volts(good.collective_V + change_V(now, grown), good.differential_V)


def amplified(gain: float) -> Bad:
    """Multiply both, beyond what carries the arm."""
    return lambda now, good, _: motor_volts(
        HOVER_V + gain * (good.collective_V - HOVER_V), gain * good.differential_V
    )


def _constant(value_V: float) -> Callable[[Any, Any], Any]:
    return lambda now, grown: value_V


def tilted(change_V: Callable[[Any], Any]) -> Bad:
    """Change the differential by ``change_V(grown)``."""
    return lambda now, good, grown: motor_volts(good.collective_V, good.differential_V + change_V(grown))


def both(voltage_V: Any) -> Volts:
    return voltage_V, voltage_V


LIFT: Final = ("elevation_envelope", "elevation_following")
TILT: Final = ("pitch_envelope", "pitch_following", "travel_envelope", "travel_following", *LIFT)
NUMBER: Final = ("not_finite",)
JUMP: Final = ("voltage_jump",)
ANY: Final = (*NUMBER, *JUMP, *TILT)
HARMLESS: Final = ("", *ANY)
"""Nobody need take over while the arm stays near its setpoint, as each flight is asked."""


class HostileLaw(NamedTuple):
    """A law, and the reasons for which the board may take over from it."""

    law: Law
    reasons: tuple[str, ...]


def row(name: str, reasons: tuple[str, ...], volts: Bad, **more: Any) -> HostileLaw:
    return HostileLaw(hostile(name, volts, **more), reasons)


def _laws_without_numbers() -> Iterator[HostileLaw]:
    """Give voltages or a setpoint that are not finite."""
    yield row("not_a_number", NUMBER, lambda now, good, _: (no_number(now), good.back_V))
    yield row("not_a_number_behind_a_limit", NUMBER, lifted(lambda now, t: no_number(now)))
    yield row(
        "not_a_number_behind_a_saturation", NUMBER,
        lambda now, good, _: motor_volts(
            good.collective_V, saturated(good.differential_V + no_number(now), -1.4, 1.4)
        ),
    )  # fmt: skip
    yield row(
        "not_a_number_for_a_pitch", NUMBER, lambda now, good, _: (good.front_V, good.back_V),
        pitch_setpoint=lambda now, good, _: good.pitch_rad + no_number(now),
    )  # fmt: skip
    yield row("infinite", NUMBER, lifted(lambda now, t: 1.0 / fmax(0.0, -1.0 - fabs(now.pitch_rad))))


def _laws_with_wrong_signs_and_gains() -> Iterator[HostileLaw]:
    """Switch between two voltages, exchange signs, or multiply by wrong gains."""
    yield row("bang_bang", JUMP, lambda now, good, _: both(if_else(_below(now), 12.0, 0.0)))
    # Within the permitted jump of a voltage, so that only the motion of the arm shows it.
    yield row("small_bang_bang", HARMLESS, lambda now, good, _: both(if_else(_below(now), 2.9, 1.0)))
    yield row(
        "bang_bang_by_rate", HARMLESS,
        lambda now, good, _: motor_volts(HOVER_V + if_else(now.elevation_rad_s > 0.0, 1.2, -1.2), 0.0),
    )  # fmt: skip
    yield row(
        "sign_error", LIFT + JUMP,
        lambda now, good, _: (2.0 + HOVER_V - good.back_V, 2.0 + HOVER_V - good.front_V),
    )  # fmt: skip
    yield row(
        "sign_error_where_it_is_high", HARMLESS,
        lambda now, good, _: motor_volts(
            if_else(now.elevation_setpoint_rad > 0.03, 2.0 * HOVER_V, 0.0)
            + if_else(now.elevation_setpoint_rad > 0.03, -good.collective_V, good.collective_V),
            good.differential_V,
        ),
    )  # fmt: skip
    yield row("sign_error_of_pitch", TILT, lambda now, good, _: (good.back_V, good.front_V))
    for gain in (-2.0, 1e6, 1e30):
        yield row(f"gain_{gain:g}", ANY, amplified(gain))
    yield row("no_gain", HARMLESS, amplified(0.0))


def _laws_of_wrong_lift() -> Iterator[HostileLaw]:
    """Lift too much or too little, suddenly or slowly."""
    for more_V in (50.0, -50.0, 2.0, -0.6, 1e38):
        yield row(f"lift_{more_V:g}", HARMLESS, lifted(_constant(more_V)))
    yield row("full_voltage", JUMP, lambda now, good, _: both(12.0))
    # To full voltage, or to none, in a quarter of a second: no jump from call to call.
    yield row(
        "full_voltage_by_a_ramp", LIFT, lambda now, good, t: (good.front_V + 40.0 * t, good.back_V + 40.0 * t)
    )
    yield row("full_voltage_by_a_steep_ramp", LIFT + JUMP, lifted(lambda now, t: fmin(2400.0 * t, 20.0)))
    yield row("motors_off", LIFT, lambda now, good, t: (good.front_V - 40.0 * t, good.back_V - 40.0 * t))
    yield row("motors_off_at_once", LIFT + JUMP, lambda now, good, _: both(0.0))
    yield row("reverse", LIFT + JUMP, lambda now, good, _: both(-1.0))
    yield row(
        "dives_when_high",
        HARMLESS,
        lambda now, good, _: both(if_else(now.elevation_rad > 0.07, 0.0, good.front_V)),
    )
    yield row(
        "climbs_then_cuts", LIFT + JUMP,
        lambda now, good, t: motor_volts(if_else(t < 1.2, HOVER_V + 2.0, 0.0), good.differential_V),
    )  # fmt: skip
    yield row(
        "sinks", HARMLESS,
        lambda now, good, t: motor_volts(
            HOVER_V + HOVER_V_PER_rad * now.elevation_rad
            + 16.0 * (now.elevation_setpoint_rad - 0.157 * t - now.elevation_rad)
            - 12.0 * (now.elevation_rad_s + 0.157),
            good.differential_V,
        ),
    )  # fmt: skip
    # An integral that nothing limits, of an error that nothing can answer.
    yield row(
        "wind_up", LIFT, lambda now, good, grown: motors(follows(now, grown)),
        grows=lambda now: 15.0 * (UNREACHABLE_rad - now.elevation_rad),
    )  # fmt: skip
    yield row("drift_up", LIFT, lambda now, good, t: (good.front_V + 0.1 * t, good.back_V + 0.1 * t))
    yield row("drift_down", HARMLESS, lambda now, good, t: (good.front_V - 0.1 * t, good.back_V - 0.1 * t))
    yield row("drift_up_slowly", HARMLESS, lifted(lambda now, t: 0.02 * t))
    yield row(
        "open_loop_up",
        HARMLESS,
        lambda now, good, t: motor_volts(_hover(now) + 0.01 * t, good.differential_V),
    )
    yield row(
        "open_loop_down",
        HARMLESS,
        lambda now, good, t: motor_volts(_hover(now) - 0.02 * t, good.differential_V),
    )


def _laws_that_tilt_or_shake() -> Iterator[HostileLaw]:
    """Tilt the arm, or shake it."""
    yield row("drift_aside", TILT, lambda now, good, t: (good.front_V + 0.05 * t, good.back_V - 0.05 * t))
    yield row(
        "spins", TILT,
        lambda now, good, _: motor_volts(
            good.collective_V, 5.0 * (0.25 - now.pitch_rad) - 1.6 * now.pitch_rad_s
        ),
        pitch_setpoint=lambda now, good, _: 0.25,
    )  # fmt: skip
    yield row(
        "hides_its_pitch", TILT, lambda now, good, _: motor_volts(good.collective_V, 0.25),
        pitch_setpoint=lambda now, good, _: now.pitch_rad,
    )  # fmt: skip
    yield row("shakes_lift", HARMLESS, lifted(lambda now, t: 2.0 * sin(314.159 * t)))
    yield row("swings_lift", HARMLESS, lifted(lambda now, t: 1.5 * sin(3.14 * t)))
    yield row("shakes_pitch", HARMLESS, tilted(lambda t: 2.0 * sin(314.159 * t)))
    yield row("swings_pitch", HARMLESS, tilted(lambda t: 1.4 * sin(12.566 * t)))
    yield row(
        "swings_pitch_blindly", HARMLESS,
        lambda now, good, t: motor_volts(good.collective_V, 1.4 * sin(6.28 * t)),
        pitch_setpoint=lambda now, good, _: now.pitch_rad,
    )  # fmt: skip


def _below(now: Any) -> Any:
    return now.elevation_rad < now.elevation_setpoint_rad


def _hover(now: Any) -> Any:
    return HOVER_V + HOVER_V_PER_rad * now.elevation_setpoint_rad


def motors(good: Good) -> Volts:
    """Return its motor voltages."""
    return good.front_V, good.back_V


HOSTILE: Final = {
    each.law.name: each
    for each in (
        *_laws_without_numbers(),
        *_laws_with_wrong_signs_and_gains(),
        *_laws_of_wrong_lift(),
        *_laws_that_tilt_or_shake(),
    )
}


@dataclass(frozen=True)
class Tried:
    """A flight of a hostile law."""

    # ``taken_over`` is the reason, ``elevation_deg`` the setpoint; the rest is what the arm did from the
    # law's first tick on, and how far it was from its setpoints in the end.

    which: str
    taken_over: str
    elevation_deg: float
    highest_deg: float
    lowest_deg: float
    most_pitch_deg: float
    astray_deg: float
    state: str
    elevation_error_deg: float
    travel_error_deg: float

    def problem(self) -> str:
        """Event that the board should have prevented; empty if there is none."""
        # Rotors that hardly turn do not turn the arm.
        is_low = self.elevation_deg < LOW_deg
        near_deg = LOW_ERROR_deg if is_low else 1.0
        problems = []
        if self.state != "CLOSED_LOOP":
            problems.append(self.state)
        if self.highest_deg >= STOP_deg:
            problems.append(f"rose to {self.highest_deg:.1f} deg")
        if self.lowest_deg <= -STOP_deg and self.elevation_deg >= ROOM_deg:
            problems.append(f"fell to {self.lowest_deg:.1f} deg")
        if self.most_pitch_deg >= PITCH_STOP_deg:
            problems.append(f"pitched by {self.most_pitch_deg:.0f} deg")
        if abs(self.elevation_error_deg) >= near_deg:
            problems.append(f"{self.elevation_error_deg:.1f} deg of elevation away in the end")
        if abs(self.travel_error_deg) >= 2.0 and not is_low:
            problems.append(f"{self.travel_error_deg:.1f} deg of travel away in the end")
        if self.astray_deg >= NEAR_deg and not self.taken_over:
            problems.append(f"{self.astray_deg:.1f} deg away, and nobody took over")
        return ", ".join(problems)


def _wait_until_calm(heli: heli_host.Heli, elevation_deg: float, travel_deg: float) -> None:
    """Wait until the arm has stayed near its setpoints for two seconds, but at most for `CALM_s`."""
    near_deg = LOW_ERROR_deg if elevation_deg < LOW_deg else 1.0
    for _ in range(round(CALM_s / 2.0)):
        heli.wait(2.0)
        newest = heli.samples(last_s=2.0)
        elevation_error_deg = np.abs(np.degrees(newest.elevation_rad) - elevation_deg).max()
        travel_error_deg = np.abs(np.degrees(newest.travel_rad) - travel_deg).max()
        if elevation_error_deg < near_deg and travel_error_deg < 2.0:
            return


def tries(name: str, rig: str, seed: int, after: Callable[[heli_host.Heli], None] | None = None) -> Tried:
    """Fly a hostile law at setpoints that the seed draws of all that there are."""
    # ``after`` is called with the helicopter in the end.
    law = HOSTILE[name].law
    chance = np.random.default_rng([seed, *name.encode()])
    elevation_deg, travel_deg = chance.uniform(MIN_deg, MAX_deg), chance.uniform(-10.0, 10.0)
    with heli_host.connect(f"sil://?seed={seed}{RIGS[rig]}") as heli:
        # A check of a silent travel encoder turns a calm arm by up to 3.3 degrees; here the law is judged.
        heli.params["travel_silence_s"] = 0.0
        heli.take_off()
        heli.setpoint(elevation_deg=elevation_deg, travel_deg=travel_deg)
        heli.wait(2.0)
        start = heli.latest.tick
        taken_over = "no"
        try:
            taken_over = heli.fly_law(law.program, duration_s=LONGEST_s).taken_over
            _wait_until_calm(heli, max(elevation_deg, HANGS_deg), travel_deg)
        except heli_host.HeliError as error:
            taken_over = str(error)
        since = heli.samples(last_s=LONGEST_s + 2.0 * CALM_s)
        rows = since.tick > start
        # The law follows well for 3 s, and the guard then allows some seconds; until then it is not astray.
        flown = rows & ((np.asarray(since.flags) & Flags.LAW) != 0) & (since.tick > start + 6000)
        angle_deg = np.degrees(since.elevation_rad)
        wanted_deg = max(elevation_deg, HANGS_deg)
        newest = heli.latest
        tried = Tried(
            f"{name} on {rig}, seed {seed}, at {elevation_deg:.1f} deg: {taken_over or 'not taken over'}",
            taken_over,
            elevation_deg,
            highest_deg=float(angle_deg[rows].max()),
            lowest_deg=float(angle_deg[rows].min()),
            most_pitch_deg=float(np.degrees(np.abs(since.pitch_rad[rows])).max()),
            astray_deg=float(np.abs(angle_deg[flown] - wanted_deg).max()) if flown.any() else 0.0,
            state=heli.state.name,
            elevation_error_deg=newest.elevation_deg - wanted_deg,
            travel_error_deg=newest.travel_deg - travel_deg,
        )
        if after is not None and not tried.problem():
            after(heli)
    return tried


def main() -> None:
    """Fly every law on every rig, and print what should not have happened."""
    parser = argparse.ArgumentParser(description="hostile laws at setpoints over the whole range")
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--law", choices=HOSTILE, action="append")
    parser.add_argument("--rig", choices=RIGS, action="append")
    arguments = parser.parse_args()
    flights = bad = 0
    for name in arguments.law or HOSTILE:
        for rig in arguments.rig or RIGS:
            all_tried = [tries(name, rig, seed) for seed in range(arguments.first, arguments.last + 1)]
            problems = [attempt for attempt in all_tried if attempt.problem()]
            flights, bad = flights + len(all_tried), bad + len(problems)
            print(
                f"{name:32} {rig:12} {len(problems):3} of {len(all_tried)}; up to "
                f"{max(attempt.highest_deg for attempt in all_tried):.1f} deg, pitch "
                f"{max(attempt.most_pitch_deg for attempt in all_tried):.0f} deg; "
                f"{', '.join(sorted({attempt.taken_over or '-' for attempt in all_tried}))[:100]}",
                flush=True,
            )
            for attempt in problems:
                print(f"    {attempt.which}: {attempt.problem()}", flush=True)
    print(f"{bad} of {flights} flights")


if __name__ == "__main__":
    main()
