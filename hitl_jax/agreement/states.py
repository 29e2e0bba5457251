"""One step, and several, from states copied out of gymnasium's walker."""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.envs import box2d
from hitl_jax.results.episode_measures import Row
from hitl_jax.walker import Walker, constants, from_gymnasium, step
from hitl_jax.walker.physics import joints
from hitl_jax.walker.physics.manifolds import FIRST_BOX
from hitl_jax.walker.physics.world import World

_KINDS = ("scripted", "scripted with noise", "random")
_EPISODES = 30
_STEPS = 400
_KEPT = 0.25
"""Share of the steps that are compared."""
_BATCH = 512
_NUDGE = 1e-6
"""By which a hull is moved to see how much two rollouts that begin alike differ anyway [m]."""
_CLOSE = 1e-2


class _Seen(NamedTuple):
    """A step of gymnasium's walker.

    Attributes:
        walker: before it, without a batch axis.
        action: [4].
        observation: after it [24].
        first: whether it is one of the first five of its episode.
        terminated: whether it ended the episode.
    """

    walker: Walker
    action: np.ndarray
    observation: np.ndarray
    first: bool
    terminated: bool


def measure_step(seed: int, env_id: str) -> list[Row]:
    """Errors of the observation after one step from equal states."""
    seen = list(_steps(np.random.default_rng(seed), env_id))
    walkers = _stacked([one.walker for one in seen])
    actions = jnp.asarray(np.stack([one.action for one in seen]))
    found = _observations(walkers, actions)
    error = np.abs(found - np.stack([one.observation for one in seen]))
    contacts = walkers.world.contacts
    touching = np.asarray(contacts.touching).any((1, 2))
    boxed = np.asarray(contacts.touching & (contacts.edge >= FIRST_BOX)).any((1, 2))
    bend = np.asarray(joints.angles(jnp.moveaxis(walkers.world.angle, 0, -1)))
    limit = ((bend <= constants.LOWER[:, None]) | (bend >= constants.UPPER[:, None])).any(0)
    first, last = (np.array([one[i] for one in seen]) for i in (3, 4))
    rows = []
    for name, chosen, bar in (
        ("in the air", ~touching & ~first & ~last, 1e-4),
        ("in contact", touching & ~first & ~last, 1e-3),
        ("at the stop of a joint", limit & ~first & ~last, None),
        ("on a stump, a stair or a pit's wall", boxed & ~first & ~last, None),
        ("first five steps of an episode", first, None),
        ("last step of an episode that ends by a fall", last, None),
        ("all", np.ones(len(seen), bool), None),
    ):
        row: Row = {"states": name, "number": int(chosen.sum())}
        if chosen.any():
            row |= _quantiles(error[chosen])
        if bar is not None:
            row |= {"bar of the median": bar, "bar of 95 %": 1e-2}
        rows.append(row)
    return rows


def measure_rollout(seed: int, env_id: str) -> list[Row]:
    """Errors of the observation after equal actions from equal states."""
    rng = np.random.default_rng(seed)
    rows = []
    for name, before in (("from the reset", 0), ("from step 50", 50)):
        starts, actions, observations = _rollouts(rng, before, env_id)
        found = _played(starts, actions)
        nudged = dataclasses.replace(starts, world=_nudged(starts.world))
        apart = np.abs(_played(nudged, actions) - found)
        for steps in (10, 50, 200):
            row: Row = {"rollout": f"{steps} steps {name}", "walkers": found.shape[1]}
            for label, error in (
                ("Box2D", np.abs(found[steps - 1] - observations[steps - 1])),
                ("itself, nudged", apart[steps - 1]),
            ):
                row[f"median, to {label}"] = float(f"{np.median(error):.1e}")
                close = (error.max(1) < _CLOSE).mean()
                row[f"within {_CLOSE:g}, of {label}"] = f"{100 * close:.0f} %"
            rows.append(row)
    return rows


def _quantiles(error: np.ndarray) -> Row:
    values = np.quantile(error, [0.5, 0.95, 0.99, 1.0])
    names = ("median error", "95 %", "99 %", "most")
    return {name: float(f"{value:.1e}") for name, value in zip(names, values, strict=True)}


def _steps(rng: np.random.Generator, env_id: str) -> Iterator[_Seen]:
    """Steps of gymnasium's walker, of several kinds of players."""
    for episode in range(_EPISODES):
        env = _made(env_id)
        observation, _ = env.reset(seed=int(rng.integers(2**31)))
        act = _player(_KINDS[episode % len(_KINDS)], rng)
        for count in range(_STEPS):
            action = act(observation)
            kept = count < 5 or rng.random() < _KEPT
            walker = copied(env) if kept else None
            observation, _, terminated, _, _ = env.step(action)
            if walker is not None:
                yield _Seen(walker, action, observation, count < 5, terminated)
            if terminated:
                break


def _rollouts(
    rng: np.random.Generator, before: int, env_id: str
) -> tuple[Walker, jax.Array, np.ndarray]:
    """Starts [N, ...], actions [T, N, 4], observations [T, N, 24] of walkers that do not fall."""
    steps = 200
    starts: list[Walker] = []
    actions, observations = [], []
    while len(starts) < 32:
        env = _made(env_id)
        observation, _ = env.reset(seed=int(rng.integers(2**31)))
        act = _player("scripted", rng)
        played, seen = [], []
        for count in range(before + steps):
            if count == before:
                start = copied(env)
            action = act(observation)
            observation, _, terminated, _, _ = env.step(action)
            if terminated:
                break
            if count >= before:
                played.append(action)
                seen.append(observation)
        if len(played) == steps:
            starts.append(start)
            actions.append(played)
            observations.append(seen)
    moved = np.moveaxis(np.array(observations), 0, 1)
    return _stacked(starts), jnp.asarray(np.moveaxis(np.array(actions), 0, 1)), moved


def _made(env_id: str) -> Any:
    """One for each episode: Box2D's order of contacts depends on what its world held before."""
    import gymnasium

    with box2d.quiet():
        return gymnasium.make(env_id, disable_env_checker=True).unwrapped


def _player(kind: str, rng: np.random.Generator) -> Any:
    from gymnasium.envs.box2d.bipedal_walker import BipedalWalkerHeuristics

    script = BipedalWalkerHeuristics()

    def act(observation: np.ndarray) -> np.ndarray:
        if kind == "random":
            return rng.uniform(-1, 1, 4).astype(np.float32)
        action = np.array(script.step_heuristic(observation), np.float32)
        if kind == "scripted":
            return action
        return np.clip(action + rng.normal(0, 0.3, 4).astype(np.float32), -1, 1)

    return act


def copied(env: Any) -> Walker:
    """The walker of a gymnasium environment; the reward of its first `step` means nothing.

    Args:
        env: gymnasium's `BipedalWalker`, after its reset.
    """
    world = jax.tree.map(lambda leaf: np.asarray(leaf)[..., 0], from_gymnasium.world_of(env))
    return Walker(world, from_gymnasium.terrain_of(env), np.float32(0), np.int32(0))  # type: ignore[arg-type]


def _stacked(walkers: list[Walker]) -> Walker:
    result: Walker = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *walkers)
    return result


_step = jax.jit(jax.vmap(step))


def _observations(walkers: Walker, actions: jax.Array) -> np.ndarray:
    """After a step of each, [N, 24]; in batches of one size, so that one program is compiled."""
    count = len(actions)
    found = []
    for begin in range(0, count, _BATCH):
        rows = np.minimum(np.arange(begin, begin + _BATCH), count - 1)
        _, after = _step(jax.tree.map(lambda leaf, at=rows: leaf[at], walkers), actions[rows])
        found.append(np.asarray(after.observation))
    return np.concatenate(found)[:count]


def _played(walkers: Walker, actions: jax.Array) -> np.ndarray:
    """Observations [T, N, 24] after each of a row of actions [T, N, 4]."""
    found = []
    for action in actions:
        walkers, after = _step(walkers, action)
        found.append(np.asarray(after.observation))
    return np.stack(found)


def _nudged(world: World) -> World:
    place = dataclasses.replace(world.place, x=world.place.x.at[:, 0].add(_NUDGE))
    return dataclasses.replace(world, place=place)
