"""Simulated flights with hidden effects, which are stored so that all tests share them."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca
from heli_host.data.flight import Flight
from heli_host.fly.plan import Plan
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import Effect, Operands
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.identify import made
from tests.identify.made import flown, flown_by_plan, thinned
from tests.running.kept import FLOWN, KEPT
from tests.running.long import LONG

# Durations of the fitted and of the held-out flight. A diagnosis of half the flight takes half as long, and
# has the same result for these effects.
WHOLE_S = (34.0, 26.0)
SHORT_S = WHOLE_S if LONG else (18.0, 14.0)
MADE_BY = (Path(__file__), Path(made.__file__))


@dataclass(frozen=True)
class Unlisted(Effect):
    """A pitch torque proportional to elevation: an effect that the catalogue lacks."""

    def torque_Nm(self, at: Operands) -> ca.SX:
        """See `Effect.torque_Nm`."""
        return ca.vertcat(0, 0.05 * at.state["elevation_rad"], 0)


@cache
def flights(
    *effects: str, unlisted: bool = False, seconds: tuple[float, float] = SHORT_S
) -> tuple[Flight, Flight]:
    """Return a flight to fit and a held-out flight, both with the given effects."""
    # `unlisted` adds an effect that the catalogue lacks; `seconds` are the durations.
    name = f"hidden {effects} {unlisted} {seconds}"
    return KEPT(name, lambda: _flown(effects, unlisted, seconds), made_by=MADE_BY, rooms=FLOWN)


def _flown(effects: tuple[str, ...], unlisted: bool, seconds: tuple[float, float]) -> tuple[Flight, Flight]:
    """Fly both flights on a rig whose thrust gain and travel friction differ from the rig file."""
    rig = load_rig("makki2024").replace(thrust_gain=0.62, friction_travel=0.05)
    hidden: tuple[Effect, ...] = parse_effects(effects)
    if unlisted:
        hidden = (*hidden, Unlisted("off_list"))
    model = MultibodyModel(hidden)
    fit = thinned(flown(rig, 11, seconds[0], model), 2)
    held_out = thinned(flown(rig, 12, seconds[1], model), 2)
    return fit, held_out


@cache
def hovering(seconds: float) -> Flight:
    """Return a flight that takes off and hovers, without excitation."""
    plan = f"title = 'Still'\n[[segment]]\nkind = 'hold'\nduration_s = {seconds}\n"
    return thinned(flown_by_plan(load_rig("makki2024"), 13, Plan.parse(plan, "still")), 2)
