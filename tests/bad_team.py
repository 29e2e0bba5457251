"""Choices as somebody else writes them, each with one fault."""

import dataclasses

import jax.numpy as jnp

from hitl_jax.arbiter import Intervention
from hitl_jax.boundary import BoundarySource
from hitl_jax.choices.options import Option
from hitl_jax.human import HumanPart, memoryless
from hitl_jax.human.actions import policy
from hitl_jax.learner.algorithms import ddpg


def of_two(observation, other):
    return observation[0]


def branching(observation):
    return observation[0] if observation[0] > 0 else -observation[0]


def text(observation):
    return "tilted"


def raises(*_, **__):
    raise RuntimeError("no battery")


def asks(*_, **__):
    return {}["battery"]


def leaves(*_, **__):
    raise SystemExit(0)


def judging(rule):
    return memoryless(lambda params, seen, dangerous, key: rule(params, seen))


def a_number():
    return judging(lambda params, seen: jnp.abs(seen[0]))


def three_truths():
    return judging(lambda params, seen: seen > 0.0)


def unknown_option():
    return judging(lambda params, seen: seen[0] > params.extra["nowhere"])


def forgetful():
    return HumanPart(
        lambda: 0, lambda state: state, lambda *_: (0.5, True), lambda state, *_: state
    )


def of_four_bits():
    return HumanPart(
        lambda: jnp.zeros(2, "int4"), lambda state: state, lambda state, *_: (state, True), _same
    )


def _same(state, *_):
    return state


def one_action(action_size):
    return policy(lambda params, seen: jnp.zeros(action_size + 1), None)


def source(init=lambda tau: tau, tau=lambda carry, network: network, options=()):
    return BoundarySource(init, tau, lambda carry, move: carry, options)


def counting():
    return source(lambda tau: jnp.zeros(2, jnp.int32))


def remembering():
    return source(lambda tau: {"tau": tau})


def three_boundaries():
    return source(tau=lambda carry, network: jnp.zeros(3))


def plain_option():
    return source(options=(("drift", 0.1, "what"),))


def no_default():
    return source(options=(Option("drift", float("nan"), "what"),))


def beyond_its_bounds():
    return source(options=(Option("drift", 5.0, "what", "", 0.0, 1.0),))


def without_ruling():
    return Intervention(lambda: 0, lambda state, now: (state, (now.alarmed,) * 4))


def keeps_two(now):
    return jnp.array([True, False])


def once(control):
    return control


def how_often(control, began, ended, intervened):
    return 3


@dataclasses.dataclass(frozen=True)
class Changed:
    """DDPG with other attributes or metrics."""

    inner: object
    over: tuple = ()
    metrics: tuple = ()

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return dict(self.over).get(name, getattr(self.inner, name))

    def improve(self, *given):
        state, metrics = self.inner.improve(*given)
        return state, {**metrics, **dict(self.metrics)}


def slashed(config):
    return Changed(ddpg(config), metrics=(("loss/Critic", 0.5),))


def counter(config):
    return Changed(ddpg(config), metrics=(("env_steps", 0.5),))


def of_the_boundary(config):
    return Changed(ddpg(config), metrics=(("network_boundary", 0.5),))


def of_each(config):
    return Changed(ddpg(config), metrics=(("q_of_each", (0.5, 0.5)),))


def never_last(config):
    return Changed(ddpg(config), over=(("policy_delay", 0),))


def half_last(config):
    return Changed(ddpg(config), over=(("policy_delay", 1.5),))


def two_actions(config):
    return Changed(ddpg(config), over=(("act", lambda *_: jnp.zeros(2)),))


def no_hash(config):
    return Changed(ddpg(config), metrics=([],))


class NoMetrics(Changed):
    def improve(self, *given):
        return super().improve(*given)[0]


def no_metrics(config):
    return NoMetrics(ddpg(config))
