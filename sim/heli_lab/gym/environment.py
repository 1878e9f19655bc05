"""`HoverEnv`: bring the helicopter to a setpoint and keep it there, with two voltages."""

from __future__ import annotations

from typing import Any, Final, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
from heli_sim.model.linear import trim
from heli_sim.model.multibody import MultibodyModel
from heli_sim.rig import load_rig

from heli_lab.errors import LearningError
from heli_lab.gym.domain import Domain
from heli_lab.gym.simulator import BoardInLockstep, PlantAlone, Simulator

Action = npt.NDArray[np.float32]
Observation = npt.NDArray[np.float32]

ACTION_STEP_s: Final = 0.02
EPISODE_S: Final = 10.0
AUTHORITY_V: Final = 2.0
"""Voltage either side of hover that an action may ask for: room for the lift that arms need whose
counterweight is off by its tolerance, and for steps of travel."""

_START_DEG: Final = (5.0, 5.0, 10.0)
_SIGHT: Final = np.array([np.pi, np.pi, 4.0 * np.pi, 50.0, 50.0, 50.0, 1.0, 1.0])


class HoverEnv(gymnasium.Env[Observation, Action]):
    """Keep elevation and travel at a setpoint.

    An episode begins in the air, within 5 degrees of level and 10 of travel, and lasts 10 s; it ends early,
    with no further reward, when the arm is down, an axis is at its stop, or the board takes no more voltages.

    Observation, float32, shape (8,): elevation and travel minus their setpoints at 0 and 2, pitch at 1 [rad],
    as the encoders count them; their rates as differences over a step [rad/s]; the last action.

    Action, float32, shape (2,), each -1 to 1: front and back voltage, as share of `AUTHORITY_V` above the
    voltage at which the first of the domain's rigs hovers by its own numbers. What an episode drew is not
    told.

    Reward of a step, 0 to 1: 1 less 0.5 for elevation 5 degrees off, 0.3 for travel 15 degrees off and 0.1
    for 30 degrees of pitch, each growing with the square up to there, and 0.1 for full action.

    Parameters
    ----------
    domain : Domain
        Rigs and effects; where it is not given, one rig with its numbers as uncertain as its file says.
    through : {"plant", "board"}
        Fly the equations alone, or the flight code and the link around them, which takes about five times as
        long.
    setpoint_deg : float
        Setpoints of elevation and travel are drawn evenly from within this of level [deg]; 0 for hover.
    render_mode : None
        There is nothing to see; `heli_host` draws flights.

    Raises
    ------
    LearningError
        An option that there is not.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  Gymnasium declares it so

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
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Box(
            -_SIGHT.astype(np.float32), _SIGHT.astype(np.float32), dtype=np.float32
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        nominal = load_rig(self.domain.rigs[0])
        self.hover_V: npt.NDArray[np.float64] = trim(MultibodyModel(), nominal).volts_V
        """Front and back voltage of a zero action [V], shape (2,)."""
        self._simulator: Simulator = PlantAlone() if through == "plant" else BoardInLockstep()
        self._reach_rad = float(np.deg2rad(setpoint_deg))
        self._before = np.zeros(3)
        self._setpoint = np.zeros(3)
        self._ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int or None
            Seed of this and the following episodes; None goes on with chance as it stands.
        options : dict or None
            None are known.

        Returns
        -------
        observation : ndarray of float32 (8,)
            As the class says.
        info : dict
            ``rig`` and ``effects``: what was drawn.
        """
        super().reset(seed=seed, options=options)
        drawn = self.domain.draw(self.np_random)
        state = np.zeros(6)
        state[:3] = np.deg2rad(_START_DEG) * self.np_random.uniform(-1.0, 1.0, 3)
        self._setpoint = self._reach_rad * self.np_random.uniform(-1.0, 1.0, 3) * [1.0, 0.0, 1.0]
        chance = int(self.np_random.integers(1, 2**31 - 1))
        seen = self._simulator.reset(drawn, state, self.hover_V, chance)
        self._before = seen.angles_rad
        self._ended = False
        return self._observation(seen.angles_rad, np.zeros(2)), {"rig": drawn.rig, "effects": drawn.effects}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold two voltages for `ACTION_STEP_s`.

        Parameters
        ----------
        action : ndarray of float32 (2,)
            As the class says; beyond 1 it counts as 1.

        Returns
        -------
        observation : ndarray of float32 (8,)
            As the class says.
        reward : float
            0 to 1.
        terminated : bool
            It no longer flies; ``info["why"]`` says why.
        truncated : bool
            False: `gymnasium.make` ends episodes by time.
        info : dict
            ``why`` when terminated.

        Raises
        ------
        LearningError
            The episode has ended, or none has begun.
        """
        if self._ended:
            raise LearningError("the episode has ended", "call reset")
        clipped_action = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        volts_V = np.maximum(self.hover_V + AUTHORITY_V * clipped_action, 0.0)
        seen = self._simulator.step(volts_V, round(ACTION_STEP_s * 1e3))
        observation = self._observation(seen.angles_rad, clipped_action)
        self._before = seen.angles_rad
        if not seen.flying:
            self._ended = True
            return observation, 0.0, True, False, {"why": seen.why}
        return observation, self._reward(seen.angles_rad - self._setpoint, clipped_action), False, False, {}

    def close(self) -> None:
        """Let go of the simulation; a second call does nothing."""
        self._ended = True
        self._simulator.close()

    def _observation(
        self, angles_rad: npt.NDArray[np.float64], action: npt.NDArray[np.float64]
    ) -> Observation:
        rates = (angles_rad - self._before) / ACTION_STEP_s
        seen = np.concatenate((angles_rad - self._setpoint, rates, action))
        return np.clip(seen, -_SIGHT, _SIGHT).astype(np.float32)

    @staticmethod
    def _reward(error_rad: npt.NDArray[np.float64], action: npt.NDArray[np.float64]) -> float:
        shares = np.minimum((error_rad / np.deg2rad([5.0, 30.0, 15.0])) ** 2, 1.0)
        return float(1.0 - shares @ [0.5, 0.1, 0.3] - 0.1 * np.mean(action**2))
