import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from learners import LEARNERS

from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.errors import InvalidValue
from hitl_jax.learner import frame, replay
from hitl_jax.learner.human_data import BOUND, HUMAN_DATA, WEIGHT, Drawn
from hitl_jax.results.episode_measures import WALKER_ENDS
from hitl_jax.team import agent as agents
from hitl_jax.training.step_booking import frames_of
from hitl_jax.types import Transition

_LAYOUT = frame.Layout(observation_size=1, action_size=1)


def _memory(count, human=(), **ended):
    """A ring of one run whose observation is the frame's number."""
    frames, numbers = np.zeros((1, count, _LAYOUT.width), np.float32), np.arange(count)
    frames[0, :, 0] = numbers
    frames[0, :, _LAYOUT.event] = frame.CUT_OFF * np.isin(numbers, human)
    for column, where in ended.items():
        frames[0, :, getattr(_LAYOUT, column)] = np.isin(numbers, where)
    return replay.add(replay.init(count, 1, _LAYOUT), jnp.asarray(frames))


def _draw(memory, batch=64, **more):
    drawn = replay.draw(memory, _LAYOUT, 0, jax.random.key(3), batch, 1, 0.9, **more)
    return replay.read(memory, _LAYOUT, 0, drawn)


def _batch(rows=8, seed=0):
    rng = np.random.default_rng(seed)
    return Transition(
        observation=jnp.asarray(rng.normal(size=(rows, 24)), jnp.float32),
        action=jnp.asarray(rng.uniform(-1, 1, (rows, 4)), jnp.float32),
        reward=jnp.zeros(rows),
        discount=jnp.zeros(rows),
        next_observation=jnp.zeros((rows, 24)),
        human=jnp.asarray(np.arange(rows) % 2, jnp.float32),
    )


def test_a_human_step_is_one_that_the_human_took_within_an_episode():
    memory = _memory(8, human=(2, 3, 4, 6), terminated=(4,), truncated=(6,), final=(5, 7))
    told = replay.is_human(memory, _LAYOUT, 0, jnp.arange(8))
    assert np.flatnonzero(told).tolist() == [2, 3]


@pytest.mark.parametrize("batches", [1, 4])
def test_half_of_each_minibatch_is_the_humans_where_some_is_found(batches):
    memory = _memory(512, human=range(0, 512, 4))
    batch = _draw(memory, 256, human_share=0.5, num_batches=batches)
    by_batch = np.asarray(batch.human).reshape(batches, -1)
    half = by_batch.shape[1] // 2
    # A quarter of the steps are the human's: 16 draws miss them all once in a hundred times.
    assert by_batch[:, :half].mean() > 0.95
    assert 0.1 < by_batch[:, half:].mean() < 0.4
    np.testing.assert_array_equal(batch.human, np.asarray(batch.observation[:, 0]) % 4 == 0)


def test_without_human_steps_others_take_their_place():
    memory = _memory(64, final=(10, 20))
    batch = _draw(memory, 256, human_share=0.5)
    assert not np.asarray(batch.human).any()
    assert not np.isin(batch.observation, (10, 20)).any()


def test_what_is_not_sought_is_drawn_as_before():
    memory = _memory(64, human=range(32))
    plain, half = _draw(memory), _draw(memory, human_share=0.5)
    np.testing.assert_array_equal(plain.observation[32:], half.observation[32:])


def test_imitation_by_hand():
    batch, action = _batch(), jnp.zeros((8, 4))
    loss = HUMAN_DATA.make("imitation").actor_loss({WEIGHT: jnp.float32(3.0)}, action, batch)
    np.testing.assert_allclose(loss, 3.0 * np.square(batch.action[1::2]).sum() / 8, rtol=1e-6)


def test_proxy_values_by_hand():
    batch = _batch()
    taken, machine = jnp.ones((2, 8)), jnp.zeros((2, 8))
    loss = HUMAN_DATA.make("proxy").critic_loss({BOUND: jnp.float32(3.0)}, taken, machine, batch)
    np.testing.assert_allclose(loss, 2 * (2.0**2 + 3.0**2) / 2, rtol=1e-6)


@pytest.mark.parametrize("learner", LEARNERS)
def test_the_critics_come_to_prefer_what_the_human_did(learner):
    """In the states in which the human acted, and there alone."""
    config = AgentConfig(learner=learner, human_data="proxy", hidden_sizes=(32, 32))
    agent, batch = agents.make_agent(config), _batch()
    hyper = hyper_for(Method.HITL_AC, Hyper(actor_learning_rate=0.0))
    state = agents.init(agent, jax.random.key(0))
    noise = jnp.zeros((8, agent.learner.noise_size))
    step = jax.jit(lambda state: agents.update(agent, hyper, state, batch, noise)[0])
    for _ in range(600):
        state = step(state)
    learned, actor = state.learner, agent.learner.actor
    machine = actor.apply(learned.actor, batch.observation)
    answers = (
        agent.learner.critic.apply(learned.critic, batch.observation, action)
        for action in (batch.action, machine)
    )
    of_human, of_machine = (np.asarray(q).reshape(len(q), 8, -1).mean((0, 2)) for q in answers)
    assert (of_human[1::2] > 0.4).all()  # The TD target is 0, the value that is told 1.
    assert (of_machine[1::2] < -0.7).all()
    assert np.abs(of_human[::2]).max() < 0.3


def test_proxy_values_are_refused_beside_a_reward():
    agent = agents.make_agent(AgentConfig(human_data="proxy"))
    agents.validate(agent, Hyper(reward_weight=0.0))
    with pytest.raises(
        InvalidValue, match=r"^reward_weight 1\.0: must be 0 beside human_data proxy"
    ):
        agents.validate(agent, Hyper())
    with pytest.raises(InvalidValue, match=r"proxy_value"):
        agents.validate(agent, Hyper(reward_weight=0.0, extra={BOUND: -1.0}))


@pytest.mark.slow
@pytest.mark.parametrize("learner", LEARNERS)
def test_the_actor_comes_to_do_what_the_human_did(learner):
    """In the states in which the human acted, and there alone, with a pull beside the value."""

    def distance(name):
        config = AgentConfig(learner=learner, human_data=name, hidden_sizes=(32, 32))
        agent, batch = agents.make_agent(config), _batch()
        hyper = hyper_for(Method.HITL_AC, Hyper(extra={WEIGHT: 100.0} if "im" in name else {}))
        state = agents.init(agent, jax.random.key(0))
        noise = jnp.zeros((8, agent.learner.noise_size))
        step = jax.jit(lambda state: agents.update(agent, hyper, state, batch, noise)[0])
        for _ in range(300):
            state = step(state)
        action = agent.learner.actor.apply(state.learner.actor, batch.observation)
        away = np.square(np.asarray(action - batch.action)).sum(axis=1)
        return away[1::2].mean(), away[::2].mean()

    of_human, of_machine = distance("imitation")
    assert of_human < 0.05 < of_machine
    assert distance("half")[0] > 0.5


def test_a_learner_that_does_not_look_at_it_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Deaf:
        inner: object

        def __getattr__(self, name):
            if name in ("human_data", "inner") or name.startswith("__"):
                raise AttributeError(name)
            return getattr(self.inner, name)

    deaf = Deaf(AgentConfig().task_learner)
    agents.make_agent(AgentConfig(human_data="half"), learner=deaf)
    for name in ("imitation", "proxy"):
        said = f"human_data {name}: this task learner does not look"
        with pytest.raises(InvalidValue, match=said):
            agents.make_agent(AgentConfig(human_data=name), learner=deaf)


@pytest.mark.parametrize("share", [1.5, -0.1, None, float("nan")])
def test_a_share_that_is_none_is_refused(share):
    with pytest.raises(InvalidValue, match="share"):
        HUMAN_DATA.require(Drawn(share=share), "mine", "human_data")


@dataclasses.dataclass(frozen=True)
class Wrong(Drawn):
    """One of a user's own, whose loss is no number."""

    changes_actor: bool = True

    def actor_loss(self, extra, action, batch):
        return jnp.zeros(3)


@dataclasses.dataclass(frozen=True)
class WrongOfCritics(Drawn):
    """Likewise."""

    changes_critic: bool = True

    def critic_loss(self, extra, taken, machine, batch):
        return taken


@pytest.mark.parametrize("name", ["Wrong", "WrongOfCritics"])
def test_one_of_ones_own_that_gives_no_number_is_refused(name):
    with pytest.raises(InvalidValue, match=f"human_data {__name__}:{name}: .*one number"):
        agents.make_agent(AgentConfig(human_data=f"{__name__}:{name}"))


def test_transitions_of_ones_own_need_not_say_who_acted():
    batch = dataclasses.replace(_batch(), human=None)
    loss = HUMAN_DATA.make("imitation").actor_loss({WEIGHT: 3.0}, batch.action + 1.0, batch)
    assert float(loss) == 0.0


@pytest.mark.parametrize("name", ["transitions", "half"])
def test_a_learner_that_makes_something_else_of_it_is_refused(name):
    imitates = AgentConfig().task_learner
    with pytest.raises(InvalidValue, match=f"human_data {name}: the task learner was made with"):
        agents.make_agent(AgentConfig(human_data=name), learner=imitates)


def test_a_learner_of_ones_own_needs_not_tell_the_options_of_the_choice():
    @dataclasses.dataclass(frozen=True)
    class Silent:
        inner: object
        options: tuple = ()

        def __getattr__(self, name):
            if name == "inner" or name.startswith("__"):
                raise AttributeError(name)
            return getattr(self.inner, name)

    agent = agents.make_agent(AgentConfig(), learner=Silent(AgentConfig().task_learner))
    assert WEIGHT in agent.options


@struct.dataclass
class Counts:
    """Of human steps in the first and the second half, and of minibatches."""

    actor: jax.Array


@dataclasses.dataclass(frozen=True)
class Recording:
    """Two updates share their targets; counts the human's steps in each half of a minibatch."""

    policy_delay: int = 2
    noise_size: int = 0
    options: tuple = ()

    def targets(self, hyper, state, batch, noise):
        return batch.reward

    def improve(self, hyper, state, batch, target, noise, last):
        halves = batch.human.reshape(2, -1).mean(1)
        return Counts(state.actor + jnp.stack([*halves, 1.0])), {}


def test_all_minibatches_of_a_call_have_their_half():
    agent = agents.make_agent(AgentConfig(human_data="half", tested_actor="last", batch_size=32))
    layout, hyper = agent.layout, hyper_for(Method.SRL, Hyper())
    frames = np.zeros((1, 512, layout.width), np.float32)
    frames[0, ::8, layout.event] = frame.CUT_OFF
    memory = replay.add(replay.init(512, 1, layout), jnp.asarray(frames))
    state = agents.init(agent, jax.random.key(0))
    state = dataclasses.replace(state, learner=Counts(jnp.zeros(3)))
    agent = agent._replace(learner=Recording())
    first, second, count = agents.learn(agent, hyper, state, memory, jnp.int32(0), 8).learner.actor
    assert count == 8
    assert first / count > 0.75  # 16 draws find one of 1 in 8 with a probability of 0.88.
    assert second / count < 0.3


def test_a_takeover_is_read_from_the_replay_as_the_humans():
    """From what is booked of steps to what a learner is given."""
    steps = np.zeros((1, 6, _LAYOUT.step_width), np.float32)
    steps[0, :, 0] = np.arange(6)
    for name, ticks in (
        ("human_action", [1, 2, 4]),
        ("control", [1, 2, 4]),
        ("terminated", [4]),
        ("final", [5]),
    ):
        steps[0, ticks, getattr(_LAYOUT, name)] = 1.0
    rewards, nobody = (np.ones(1), np.zeros(1)), np.zeros(1, bool)
    frames, _ = frames_of(steps, _LAYOUT, AgentConfig(), *rewards, nobody, WALKER_ENDS)
    memory = replay.add(replay.init(6, 1, _LAYOUT), jnp.asarray(frames))
    told = _draw(memory)
    by_frame = dict(zip(told.observation[:, 0].tolist(), told.human.tolist(), strict=True))
    assert by_frame == {0.0: 0.0, 1.0: 1.0, 2.0: 1.0, 3.0: 0.0, 4.0: 0.0}
