"""The environments: what their checkers ask, what a policy observes, and that they run what `explore` runs."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from agent.strategies.burgard import Nearest
from agent.strategies.options import with_defaults
from agent.strategies.targets import Parts
from deploy.scenario.errors import ScenarioError
from murmur import Result, explore
from murmur.gym import ENVIRONMENT, ExploreEnv, Progress, TeamEnv
from protocol.grid import FREE, UNKNOWN

SMALL: dict[str, Any] = {"map": "leader-rooms", "robots": 2, "sensor_range": 2.5, "range": "30%"}


class NearestSegment(Nearest):
    """What robots do whose policy always takes the nearest candidate."""

    name = "nearest-segment"
    options_type = with_defaults(Parts, candidates="rfe")
    publishes_target = publishes_pose = True


@pytest.fixture(autouse=True)
def no_warnings() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def nearest(observation: dict[str, Any]) -> int:
    """Keep the target if that is allowed, else take the nearest candidate."""
    return int(not observation["action_mask"][0])


def finish(env: ExploreEnv, seed: int, choose: Callable[[dict[str, Any]], int] = nearest) -> list[Any]:
    """Run an episode; return what each step returns."""
    observation, _ = env.reset(seed=seed)
    taken: list[Any] = []
    while not taken or not any(taken[-1][2:4]):
        taken.append(env.step(choose(observation)))
        observation = taken[-1][0]
    return taken


def finish_team(env: TeamEnv, seed: int) -> Result:
    observations, _ = env.reset(seed=seed)
    while env.agents:
        observations, *_ = env.step({agent: nearest(observations[agent]) for agent in env.agents})
    return env.result


def test_gymnasiums_checker_accepts_the_environment() -> None:
    env = gymnasium.make(f"murmur.gym:{ENVIRONMENT}", render_mode="rgb_array", steps=30, **SMALL)
    check_env(env.unwrapped)


def test_pettingzoos_tests_accept_the_environment() -> None:
    parallel_api_test(TeamEnv(steps=30, **SMALL), num_cycles=40)
    parallel_seed_test(lambda: TeamEnv(steps=30, **SMALL), num_cycles=10)


@pytest.mark.parametrize("robots", [1, 3])
def test_a_policy_that_takes_the_nearest_candidate_equals_the_strategy_that_does(robots: int) -> None:
    settings = SMALL | {"robots": robots}
    plain = explore(**settings, strategy=NearestSegment, seed=4, bus="memory", keep=False)
    result = finish_team(TeamEnv(**settings), seed=4)
    assert result.summary["finished"]
    assert result.summary["digest"] == plain.summary["digest"]


def test_one_robot_follows_its_policy_and_its_teammates_a_strategy() -> None:
    settings = SMALL | {"strategy": NearestSegment}
    plain = explore(**settings, bus="memory", keep=False)
    env = ExploreEnv(robot=1, **settings)
    finish(env, seed=0)
    assert env.result.summary["digest"] == plain.summary["digest"]
    finish(env, seed=0, choose=lambda observation: int(observation["action_mask"].nonzero()[0][-1]))
    assert env.result.summary["digest"] != plain.summary["digest"]


def test_seed_and_actions_determine_the_episode() -> None:
    def trajectory(seed: int) -> list[list[Any]]:
        random = np.random.default_rng(0)
        return finish(
            ExploreEnv(**SMALL), seed, lambda seen: int(random.choice(seen["action_mask"].nonzero()[0]))
        )

    first, again, other = trajectory(3), trajectory(3), trajectory(5)
    assert len(first) == len(again)
    for one, same in zip(first, again, strict=True):
        assert all((one[0][name] == same[0][name]).all() for name in one[0])
        assert one[1:] == same[1:]
    assert [each[1] for each in first] != [each[1] for each in other]


def test_episodes_without_a_seed_differ_and_follow_from_the_last_seed() -> None:
    for env in (ExploreEnv(steps=1, **SMALL), TeamEnv(steps=1, **SMALL)):

        def seeds(env: Any = env) -> list[int]:
            infos = [env.reset(seed=7)[1], env.reset()[1], env.reset()[1]]
            return [info.get("r0", info)["seed"] for info in infos]

        assert seeds() == seeds()
        assert len(set(seeds())) == 3
        assert seeds()[0] == 7


def test_a_robot_observes_what_it_knows_and_nothing_else() -> None:
    env = ExploreEnv(**SMALL | {"range": 0})
    taken = finish(env, seed=0)
    own = env.result.records.own[0]
    for observation, *_ in taken:
        known = observation["map"] != UNKNOWN
        assert (observation["map"][known] == own[known]).all()
        assert (observation["team"][1] == -1).all()
        assert (observation["team"][0, :2] == observation["position"]).all()


def test_a_robot_observes_poses_and_targets_that_teammates_have_sent() -> None:
    observations, _ = TeamEnv(**SMALL | {"range": "100%"}).reset(seed=0)
    assert (observations["r0"]["team"][1, :2] == observations["r1"]["position"]).all()
    env = ExploreEnv(**SMALL | {"range": "100%"})
    assert any((observation["team"][1, 2:] >= 0).all() for observation, *_ in finish(env, seed=0))


def test_candidates_are_frontier_cells_and_the_nearest_comes_first() -> None:
    env = ExploreEnv(candidates=3, **SMALL)
    observation, _ = env.reset(seed=0)
    assert observation["action_mask"].tolist() == [0, 1, 1, 1]
    ways = observation["candidates"][:, 2]
    assert (np.diff(ways) >= 0).all()
    for x, y, way, gain in observation["candidates"].astype(int):
        assert observation["map"][y, x] == FREE
        assert (observation["map"][y - 1 : y + 2, x - 1 : x + 2] == UNKNOWN).any()
        assert way >= np.abs(observation["position"] - (x, y)).max()
        assert gain > 0
    assert env.action_masks().tolist() == [False, True, True, True]


def test_a_robot_without_a_goal_stays_for_a_step() -> None:
    env = ExploreEnv(candidates=50, **SMALL)
    before, info = env.reset(seed=0)
    for action in (0, 50):
        assert not before["action_mask"][action]
        after, _, _, _, later = env.step(action)
        assert (after["position"] == before["position"]).all()
        assert later["step"] == info["step"] + 1
        info = later


def test_a_policy_may_choose_again_on_the_way() -> None:
    env = ExploreEnv(every=1, **SMALL)
    taken = finish(env, seed=0)
    assert {info["steps"] for *_, info in taken[:-1]} == {1}
    once = finish(ExploreEnv(**SMALL), seed=0)
    assert len(once) < len(taken)
    assert once[-1][4]["step"] == taken[-1][4]["step"]


def test_rewards_add_up_to_the_share_that_was_seen_minus_the_cost_of_steps() -> None:
    env = ExploreEnv(**SMALL)
    _, begun = env.reset(seed=0)
    taken = finish(env, seed=0)
    last = taken[-1][4]
    gained = 100 * (last["explored"] - begun["explored"]) - 0.1 * (last["step"] - begun["step"])
    assert sum(reward for _, reward, *_ in taken) == pytest.approx(gained)
    assert last["explored"] == pytest.approx(env.result.summary["coverage"])
    ledger = env.result.ledger
    assert (
        ledger.filter("carried")["bytes"].sum()
        == sum(step[4]["sent_bytes"] for step in taken) + begun["sent_bytes"]
    )


def test_a_caller_replaces_the_reward() -> None:
    seen: list[Progress] = []

    def reward(progress: Progress) -> float:
        seen.append(progress)
        return -progress.sent_bytes

    taken = finish(ExploreEnv(reward=reward, **SMALL), seed=0)
    assert [each[1] for each in taken] == [-progress.sent_bytes for progress in seen]
    assert [progress.is_over for progress in seen] == [False] * (len(seen) - 1) + [True]


def test_an_episode_without_steps_left_is_truncated() -> None:
    *_, (_, _, terminated, truncated, info) = finish(ExploreEnv(steps=9, **SMALL), seed=0)
    assert (terminated, truncated, info["step"]) == (False, True, 9)
    env = TeamEnv(steps=9, **SMALL)
    assert finish_team(env, seed=0).summary["reason"] == "out of steps"


def test_a_lost_robot_is_terminated() -> None:
    settings = SMALL | {"fault": [{"robot": 0, "step": 6, "kind": "kill"}]}
    env = ExploreEnv(**settings)
    taken = finish(env, seed=0)
    assert taken[-1][2:4] == (True, False)
    assert taken[-1][4]["step"] == 5
    team = TeamEnv(**settings)
    observations, _ = team.reset(seed=0)
    ends: dict[str, int] = {}
    while team.agents:
        observations, _, terminated, _, infos = team.step(
            {agent: nearest(observations[agent]) for agent in team.agents}
        )
        ends |= {agent: infos[agent]["step"] for agent in terminated if terminated[agent]}
    assert ends["r0"] < ends["r1"]
    assert team.result.summary["finished"]


@pytest.mark.parametrize(
    ("faults", "away"),
    [
        ([{"robot": 1, "step": 4, "kind": "stop", "steps": 3}], range(4, 7)),
        (
            [{"robot": 1, "step": 4, "kind": "kill"}, {"robot": 1, "step": 7, "kind": "restart"}],
            range(4, 7),
        ),
        ([{"robot": 1, "step": 4, "kind": "restart"}], range(0)),
    ],
)
def test_an_agent_whose_robot_will_take_part_again_remains_and_cannot_act_meanwhile(
    faults: list[dict[str, Any]], away: range
) -> None:
    team = TeamEnv(every=1, steps=12, fault=faults, **SMALL)
    observations, _ = team.reset(seed=0)
    unable = []
    while team.agents:
        assert team.agents == ["r0", "r1"]
        actions = {agent: nearest(observations[agent]) for agent in team.agents}
        observations, _, _, _, infos = team.step(actions)
        if observations["r1"]["action_mask"].sum() == 1:
            unable.append(infos["r1"]["step"])
    assert unable == list(away)
    assert team.result.summary["steps"] == 12


def test_settings_of_one_episode_are_options_of_its_reset() -> None:
    settings = SMALL | {"map": "unstructured", "map_options": {"resolution": 0.4}}
    env = ExploreEnv(render_mode="rgb_array", **settings)

    def picture(options: dict[str, Any] | None) -> Any:
        env.reset(seed=0, options=options)
        return env.render()

    plain, other = picture({"unknown": 1}), picture({"settings": {"map_seed": 3}})
    assert (plain != other).any()
    assert (plain == picture(None)).all()
    with pytest.raises(
        ScenarioError, match=r"must be those of the environment, \(62, 62, 2\), not \(62, 62, 3\)"
    ):
        picture({"settings": {"robots": 3}})


def test_a_picture_shows_the_world_and_the_robots() -> None:
    env = ExploreEnv(render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    begun = env.render()
    assert begun is not None
    finish(env, seed=0)
    done = env.render()
    assert done is not None
    assert begun.shape == done.shape == (500, 500, 3)
    white = [(picture == 255).all(axis=2).sum() for picture in (begun, done)]
    assert white[0] < white[1]
    assert ExploreEnv(**SMALL).render_mode is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"robot": 2}, r"robot = 2: the team has 2 robots, from 0"),
        ({"candidates": 0}, r"candidates = 0: must be at least 1"),
        ({"every": -1}, r"every = -1: must be at least 0"),
        ({"seed": 3}, r"seed = 3: each episode has its own; give it to reset"),
        ({"render_mode": "human"}, r"render_mode = 'human': must be 'rgb_array', or None"),
        ({"robts": 3}, r"robts: unknown setting"),
        ({"clock": "wall"}, r"clock = 'barrier'"),
    ],
)
def test_wrong_arguments_are_explained(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ExploreEnv(**SMALL | wrong)


def test_calls_in_the_wrong_order_are_explained() -> None:
    env, team = ExploreEnv(**SMALL), TeamEnv(**SMALL)
    for call in (lambda: env.step(1), lambda: team.step({}), env.action_masks):
        with pytest.raises(RuntimeError, match="call reset first"):
            call()
    env.reset(seed=0)
    with pytest.raises(RuntimeError, match="has not ended"):
        _ = env.result
    team.reset(seed=0)
    with pytest.raises(ValueError, match="there is no agent 'r7'; there are r0, r1"):
        team.step({"r7": 1})


def test_without_gymnasium_the_error_names_the_extra() -> None:
    program = "import sys; sys.modules['gymnasium'] = None; import murmur.gym"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == (
        "ImportError: murmur.gym needs the package gymnasium: pip install 'murmur-robots[gym]'"
    )
