"""The Gymnasium environment `HoverEnv`: move the helicopter to a setpoint, and hold it there."""

from __future__ import annotations

from typing import Any, Final, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats
from heli_sim.model.linear import trim
from heli_sim.model.multibody import MultibodyModel
from heli_sim.rig import load_rig

from heli_lab.apps.gym.simulator import BoardInLockstep, Domain, PlantAlone, Simulator
from heli_lab.errors import LearningError

Action = npt.NDArray[np.float32]
Observation = npt.NDArray[np.float32]

ACTION_STEP_s: Final = 0.02
"""Time for which an action is held [s]."""
EPISODE_S: Final = 10.0
"""Duration of an episode [s]."""
AUTHORITY_V: Final = 2.0
"""Voltage of a full action above or below hover [V]: enough for a counterweight that deviates by its
tolerance, and for steps of travel."""

_START_DEG: Final = (5.0, 5.0, 10.0)
"""Largest initial deflection of elevation, pitch and travel [deg]."""
_OBSERVATION_LIMITS: Final = np.array([np.pi, np.pi, 4.0 * np.pi, 50.0, 50.0, 50.0, 1.0, 1.0])


class HoverEnv(gymnasium.Env[Observation, Action]):
    """Environment whose task is to hold elevation and travel at a setpoint.

    An episode begins in the air, within 5 degrees of level and 10 degrees of travel, and lasts 10 s. It ends
    early, without further reward, when the arm is on its table, an axis is at its stop, or the board refuses
    voltages.

    The observation is float32 of shape (8,): elevation minus its setpoint, pitch, and travel minus its
    setpoint [rad], all quantised by the encoders; their rates as differences over a step [rad/s]; the last
    action.

    The action is float32 of shape (2,), each element -1 to 1: front and back voltage relative to hover, in
    units of `AUTHORITY_V`. Hover is that of the domain's first rig with nominal parameters. The agent does
    not observe which rig and effects were drawn.

    The reward of a step is 0 to 1. It is 1 minus penalties that grow with the square: 0.5 at 5 degrees of
    elevation error, 0.3 at 15 degrees of travel error, 0.1 at 30 degrees of pitch, and 0.1 at full action.
    Larger errors have the same penalty.

    Parameters
    ----------
    domain : Domain
        Distribution of rigs and effects; by default one rig with parameters drawn within its tolerances.
    through : {"plant", "board"}
        Simulate the equations of motion alone, or with flight code and link, which takes about five times as
        long.
    setpoint_deg : float
        Setpoints of elevation and travel are drawn uniformly between minus and plus this [deg]; 0 for hover.
    render_mode : None
        Rendering is not available; `heli_host` plots flights.

    Raises
    ------
    LearningError
        When an option is unknown, or a setpoint is beyond a stop of the elevation.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  as Gymnasium declares it

    def __init__(
        self,
        domain: Domain | None = None,
        *,
        through: Literal["plant", "board"] = "plant",
        setpoint_deg: float = 0.0,
        render_mode: None = None,
    ) -> None:
        if through not in ("plant", "board"):
            raise LearningError(f"through='{through}' is unknown", "give 'plant' or 'board'")
        self.domain = domain if domain is not None else Domain(tolerances=1.0)
        stops_deg = [
            abs(load_rig(rig)[stop].value)
            for rig in self.domain.rigs
            for stop in ("elevation_min", "elevation_max")
        ]
        if not 0.0 <= setpoint_deg < min(stops_deg):
            raise LearningError(
                f"setpoint_deg={setpoint_deg} is beyond a stop of the elevation",
                f"give a number from 0 to less than {min(stops_deg):g}",
            )
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Box(
            -_OBSERVATION_LIMITS.astype(np.float32), _OBSERVATION_LIMITS.astype(np.float32), dtype=np.float32
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        nominal = load_rig(self.domain.rigs[0])
        self.hover_V: Floats = trim(MultibodyModel(), nominal).volts_V
        """Front and back voltage of an action of 0 [V], shape (2,)."""
        self._simulator: Simulator = PlantAlone() if through == "plant" else BoardInLockstep()
        self._setpoint_range_rad = float(np.deg2rad(setpoint_deg))
        self._previous_rad = np.zeros(3)
        self._setpoint_rad = np.zeros(3)
        self._has_ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int or None
            Seed of this and the following episodes; None continues the random sequence.
        options : dict or None
            Ignored; there are no options.

        Returns
        -------
        observation : ndarray of float32 (8,)
            See the class.
        info : dict
            ``rig`` and ``effects`` of the episode.
        """
        super().reset(seed=seed, options=options)
        drawn = self.domain.draw(self.np_random)
        angles_rad = np.deg2rad(_START_DEG) * self.np_random.uniform(-1.0, 1.0, 3)
        at_rest_rad_s = np.zeros(3)
        # Pitch has no setpoint. Its number is drawn all the same, so that a seed keeps its episodes.
        elevation_rad, _, travel_rad = self._setpoint_range_rad * self.np_random.uniform(-1.0, 1.0, 3)
        self._setpoint_rad = np.array([elevation_rad, 0.0, travel_rad])
        simulator_seed = int(self.np_random.integers(1, 2**31 - 1))
        state = np.concatenate((angles_rad, at_rest_rad_s))
        result = self._simulator.reset(drawn, state, self.hover_V, simulator_seed)
        self._previous_rad = result.angles_rad
        self._has_ended = False
        hover_action = np.zeros(2)
        observation = self._observation(result.angles_rad, hover_action)
        return observation, {"rig": drawn.rig, "effects": drawn.effects}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold two voltages for `ACTION_STEP_s`.

        Parameters
        ----------
        action : ndarray of float32 (2,)
            See the class; values beyond 1 are clipped.

        Returns
        -------
        observation : ndarray of float32 (8,)
            See the class.
        reward : float
            0 to 1.
        terminated : bool
            Whether the flight has ended; ``info["why"]`` states the reason.
        truncated : bool
            Always False: `gymnasium.make` ends episodes by time.
        info : dict
            ``why`` when terminated.

        Raises
        ------
        LearningError
            When the episode has ended, none has begun, or the action is not two numbers.
        """
        if self._has_ended:
            raise LearningError("the episode has ended", "call reset() first")
        shares = np.asarray(action, np.float64)
        if shares.shape != (2,) or np.isnan(shares).any():
            raise LearningError(f"the action {action} is not two numbers", "check the policy")
        clipped_action = np.clip(shares, -1.0, 1.0)
        volts_V = np.maximum(self.hover_V + AUTHORITY_V * clipped_action, 0.0)
        result = self._simulator.step(volts_V, ticks=round(ACTION_STEP_s * 1e3))
        observation = self._observation(result.angles_rad, clipped_action)
        self._previous_rad = result.angles_rad
        terminated, truncated = not result.flying, False
        if terminated:
            self._has_ended = True
            return observation, 0.0, terminated, truncated, {"why": result.reason}
        reward = self._reward(result.angles_rad - self._setpoint_rad, clipped_action)
        return observation, reward, terminated, truncated, {}

    def close(self) -> None:
        """End the simulation; further calls have no effect."""
        self._has_ended = True
        self._simulator.close()

    def _observation(self, angles_rad: Floats, action: Floats) -> Observation:
        """Assemble the observation, shape (8,), from the measured angles and the last action."""
        rates = (angles_rad - self._previous_rad) / ACTION_STEP_s
        observation = np.concatenate((angles_rad - self._setpoint_rad, rates, action))
        return np.clip(observation, -_OBSERVATION_LIMITS, _OBSERVATION_LIMITS).astype(np.float32)

    @staticmethod
    def _reward(error_rad: Floats, action: Floats) -> float:
        """Compute the reward of a step, as the class describes it, from elevation, pitch and travel error."""
        penalties = np.minimum((error_rad / np.deg2rad([5.0, 30.0, 15.0])) ** 2, 1.0)
        return float(1.0 - penalties @ [0.5, 0.1, 0.3] - 0.1 * np.mean(action**2))
