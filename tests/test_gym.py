"""Episodes draw from given ranges; Gymnasium accepts them; they equal plant and board; policies learn.

Gymnasium's own checker is the witness of the interface, `Plant.step` of the physics, the board in lockstep
of the plant alone.
"""

import contextlib
import copy
import math
import os
import warnings
from typing import Any

import numpy as np
import pytest
from heli_sim.errors import EffectError, RigError
from heli_sim.model.effects import parse_effects
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig, rig_names

gymnasium = pytest.importorskip("gymnasium", reason="skipped: no gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from heli_lab.apps.gym import Domain, HoverEnv, LinearPolicy, cross_entropy, mean_return  # noqa: E402
from heli_lab.errors import LearningError  # noqa: E402

EXACT = Domain()
# Found by `heli_lab.apps.gym.cross_entropy` in 15 generations of 20.
HOVERS = LinearPolicy(
    np.array(
        [[-5.5, -0.41, -2.6, -2.23, -0.38, -3.6, 0.0, 0.0], [-5.5, 0.41, 2.6, -2.23, 0.38, 3.6, 0.0, 0.0]]
    )
)


def flown(env: Any, seed: int, steps: int = 500) -> tuple[float, Any, int]:
    """Sum of rewards, last observation and steps flown of `HOVERS`."""
    seen, _ = env.reset(seed=seed)
    total = 0.0
    for step in range(steps):
        seen, reward, ended, _, _ = env.step(HOVERS(seen))
        total += reward
        if ended:
            return total, seen, step + 1
    return total, seen, steps


@pytest.mark.medium
def test_numbers_spread_by_the_tolerances_of_the_file() -> None:
    rig, random = load_rig("makki2024"), np.random.default_rng(1)
    drawn = [Domain(tolerances=1.0).draw(random).rig for _ in range(200)]
    for name, number in rig.items():
        values = np.array([rig_[name].value for rig_ in drawn])
        assert np.abs(values - number.value).max() <= number.tolerance * (1.0 + 1e-12)
        # Half widths are of 95 %: two standard deviations, less what the cut takes (12 %).
        if number.tolerance and 0.0 < number.tolerance < 0.9 * number.value:
            assert 0.36 < np.std(values) / number.tolerance < 0.52


@pytest.mark.medium
@pytest.mark.parametrize("name", rig_names())
def test_every_shipped_rig_can_be_drawn(name: str) -> None:
    random = np.random.default_rng(2)
    for _ in range(20):
        Domain(rigs=(name,), tolerances=1.0).draw(random)


def test_effects_come_with_their_chance_and_within_their_range() -> None:
    domain, random = Domain(effects={"rotor_lag": (0.05, 0.15)}, chance=0.25), np.random.default_rng(3)
    effects = [effect for _ in range(400) for effect in domain.draw(random).effects]
    values = np.array([next(iter(effect.values.values())) for effect in effects])
    assert 70 < len(values) < 130
    assert values.min() >= 0.05 and values.max() <= 0.15 and np.std(values) > 0.02


def test_what_a_domain_cannot_draw_is_refused_at_once() -> None:
    with pytest.raises(RigError):
        Domain(rigs=("no such rig",))
    with pytest.raises(EffectError):
        Domain(effects={"no_such_effect": (0.0, 1.0)})
    for wrong in ({"rigs": ()}, {"tolerances": -1.0}, {"effects": {"rotor_lag": (0.2, 0.1)}}):
        with pytest.raises(LearningError):
            Domain(**wrong)


@pytest.mark.medium
@pytest.mark.parametrize("through", ["plant", "board"])
def test_gymnasiums_checker_finds_nothing(through: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("heli_lab.gym:HeliHover-v0", through=through)
        check_env(env.unwrapped)
        env.close()


@pytest.mark.medium
def test_an_episode_of_the_registered_environment_lasts_ten_seconds() -> None:
    env = gymnasium.make("heli_lab.gym:HeliHover-v0", domain=EXACT)
    env.reset(seed=1)
    ends = [env.step(np.zeros(2, np.float32))[3] for _ in range(500)]
    assert ends == [False] * 499 + [True]


@pytest.mark.medium
def test_the_plant_alone_is_the_plant_tick_by_tick() -> None:
    drawn = Domain(effects={"rotor_lag": (0.08, 0.08)})
    env = HoverEnv(drawn)
    env.reset(seed=3)
    simulator: Any = env._simulator
    state = simulator._state.copy()
    plant = Plant(MultibodyModel(parse_effects(["rotor_lag=0.08"])), load_rig("makki2024"))
    random = np.random.default_rng(1)
    for _ in range(5):
        action = random.uniform(-1.0, 1.0, 2)
        seen, *_ = env.step(action.astype(np.float32))
        volts_V = np.maximum(env.hover_V + 2.0 * action.astype(np.float32), 0.0)
        for _ in range(20):
            state, measured = plant.step(state, volts_V)
        np.testing.assert_allclose(simulator._state, state, atol=1e-12)
        # The encoders count 4096 a revolution.
        np.testing.assert_allclose(seen[:3], measured, atol=np.pi / 4096 + 1e-6)


@pytest.mark.medium
def test_rates_are_differences_over_a_step_and_the_last_action_is_seen() -> None:
    env = HoverEnv(EXACT)
    before, _ = env.reset(seed=2)
    seen, *_ = env.step(np.array([0.5, -0.25], np.float32))
    np.testing.assert_allclose(seen[3:6], (seen[:3] - before[:3]) / 0.02, atol=1e-4)
    np.testing.assert_array_equal(seen[6:], np.array([0.5, -0.25], np.float32))


@pytest.mark.medium
def test_more_voltage_lifts_and_the_front_rotor_pitches_up() -> None:
    ends = {}
    for name, action in {"both": (1.0, 1.0), "front": (0.2, -0.2)}.items():
        env = HoverEnv(EXACT)
        start, _ = env.reset(seed=4)
        for _ in range(15):
            seen, *_ = env.step(np.array(action, np.float32))
        ends[name] = seen - start
    assert ends["both"][0] > 0.02 and ends["front"][1] > 0.05


@pytest.mark.medium
def test_a_rig_that_tips_over_ends_the_episode_and_says_why() -> None:
    env = HoverEnv(EXACT)
    env.reset(seed=5)
    reward, ended, info = 1.0, False, dict[str, Any]()
    for _ in range(500):
        _, reward, ended, _, info = env.step(np.array([1.0, -1.0], np.float32))
        if ended:
            break
    assert ended and reward == 0.0 and info["why"] == "pitch is at its stop"
    with pytest.raises(LearningError, match="call reset"):
        env.step(np.zeros(2, np.float32))


@pytest.mark.medium
def test_rewards_are_from_0_to_1_and_best_at_rest_on_the_setpoint() -> None:
    best = HoverEnv._reward(np.zeros(3), np.zeros(2))
    worst = HoverEnv._reward(np.full(3, 2.0), np.ones(2))
    assert best == 1.0 and worst == pytest.approx(0.0)
    off = np.deg2rad(2.0)
    for axis in range(3):
        assert worst < HoverEnv._reward(off * np.eye(3)[axis], np.zeros(2)) < best


@pytest.mark.medium
def test_a_policy_that_hovers_the_plant_hovers_the_board() -> None:
    plant, board = HoverEnv(EXACT), HoverEnv(EXACT, through="board")
    in_plant, seen, _ = flown(plant, seed=7, steps=300)
    on_board, seen_on_board, steps = flown(board, seed=7, steps=300)
    board.close()
    assert steps == 300 and on_board == pytest.approx(in_plant, rel=0.02)
    assert np.abs(seen[:3]).max() < 0.05 and np.abs(seen_on_board[:3]).max() < 0.05


@pytest.mark.medium
def test_an_episode_repeats_by_its_seed_on_the_board_too() -> None:
    ends = []
    for _ in range(2):
        env = HoverEnv(through="board")
        ends.append(flown(env, seed=11, steps=20)[1])
        env.close()
    np.testing.assert_array_equal(*ends)


def test_an_action_that_is_no_number_and_a_setpoint_beyond_a_stop_are_refused() -> None:
    with pytest.raises(LearningError, match="give a number from 0 to less than 25"):
        HoverEnv(setpoint_deg=25.0)
    env = HoverEnv()
    env.reset(seed=1)
    for action in ([math.nan, 0.0], [0.0, 0.0, 0.0]):
        with pytest.raises(LearningError, match="is not two numbers; check the policy"):
            env.step(np.array(action, np.float32))


def test_an_unknown_simulator_is_refused_in_one_line() -> None:
    with pytest.raises(LearningError, match="'plant' or 'board'"):
        HoverEnv(through="wire")  # type: ignore[arg-type]


@pytest.mark.parametrize("through", ["plant", "board"])
def test_a_copy_continues_the_same_episode(through: Any) -> None:
    """A search over actions copies the environment, and tries each action in a copy."""
    actions = np.random.default_rng(1).uniform(-0.2, 0.2, (12, 2)).astype(np.float32)
    with contextlib.closing(HoverEnv(through=through)) as environment:
        environment.reset(seed=3)
        for action in actions[:6]:
            environment.step(action)
        with contextlib.closing(copy.deepcopy(environment)) as copied:
            other = copied.step(np.ones(2, np.float32))[0]
            original = [environment.step(action)[0] for action in actions[6:]]
        with contextlib.closing(HoverEnv(through=through)) as again:
            again.reset(seed=3)
            repeated = [again.step(action)[0] for action in actions][6:]
    np.testing.assert_array_equal(original, repeated)
    assert (other != original[0]).any()


SEEDS = range(10**6, 10**6 + 10)
"""Episodes that nothing was searched or learned with."""
LONG = os.environ.get("HELI_LONG") == "1"


@pytest.mark.slow
def test_the_cross_entropy_method_finds_gains_that_hover() -> None:
    env = gymnasium.make("HeliHover-v0")
    generations, required = (15, 460.0) if LONG else (5, 380.0)
    policy = cross_entropy(env, generations=generations, population=20 if LONG else 12, episodes=2)
    searched, idle = mean_return(env, policy, SEEDS), mean_return(env, LinearPolicy(np.zeros((2, 8))), SEEDS)
    # 500 is the best return. Hover voltages alone let most arms sink or rise on rigs within the tolerances
    # of the file.
    assert idle < 320.0 and searched > required


@pytest.mark.slow
def test_ppo_of_stable_baselines3_learns_to_hover() -> None:
    pytest.importorskip("stable_baselines3", reason="skipped: no stable-baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    # As docs/how-to/gymnasium.md has it, for a fifth of its steps.
    four = DummyVecEnv([lambda: gymnasium.make("HeliHover-v0")] * 4)
    normalised = VecNormalize(four, gamma=0.98)
    ppo = PPO(
        "MlpPolicy",
        normalised,
        seed=1,
        device="cpu",
        n_steps=500,
        batch_size=500,
        n_epochs=8,
        gamma=0.98,
        learning_rate=1e-3,
        policy_kwargs={"net_arch": [32, 32], "log_std_init": -0.7},
    )
    ppo.learn(40_000)
    env = gymnasium.make("HeliHover-v0")

    def policy(seen: Any) -> Any:
        action, _ = ppo.predict(normalised.normalize_obs(seen), deterministic=True)
        return action

    # Holding the voltages at which the rig hovers by its file earns 260.
    assert mean_return(env, policy, SEEDS) > 350.0
