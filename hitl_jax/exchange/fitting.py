"""Fits a human to episodes in which somebody judged, and acted now and then.

The judgement is that of a network on the state of some steps ago. Of several reaction delays that
is taken whose network foretells best what was judged in episodes that it was not fitted to. The
hands imitate what the person did. How well both do is told by episodes that had no part in this.
"""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import optax

from hitl_jax.errors import ResultsError
from hitl_jax.exchange.played import Played
from hitl_jax.human.fitted import DANGER, DELAY, HANDS, LEAST
from hitl_jax.learner import adam
from hitl_jax.learner.networks import Actor, RiskNetwork
from hitl_jax.team.array_names import by_name
from hitl_jax.types import Params

_DELAYS = (0, 5, 10, 15, 20, 25, 30)
_SIZES = (64, 64)
_BATCH, _UPDATES, _LEARNING_RATE = 256, 250, 1e-3
_LOOKS = 16
"""Times `_UPDATES`, after each of which a fit is looked at."""
_EVERY = 5
"""Of so many episodes one is held out, and one chooses the delay."""
_LEAST_STEPS, _LEAST_HANDS = 200, 200
"""Judged steps that are needed, and steps in the person's hands, without which there are none."""


class Fit(NamedTuple):
    """A fitted human, and how well they do on episodes that were held out.

    Attributes:
        arrays: of the file.
        delay: how many steps back the state lies that best predicts a judgement. Since neighbouring
            states are alike, this is not the person's reaction time.
        steps: judged steps that were held out.
        dangerous: share of them that the person judged dangerous.
        agrees: share of them on which both agree.
        missed: share of the dangerous ones that the fitted human finds safe; NaN without any.
        feared: share of the others that they find dangerous; NaN without any.
        hand_steps: steps in the person's hands that were not held out.
        explained: share of the variance of the person's actions that the hands explain, on held-out
            steps; NaN without hands or without such steps.
    """

    arrays: dict[str, np.ndarray]
    delay: int
    steps: int
    dangerous: float
    agrees: float
    missed: float
    feared: float
    hand_steps: int
    explained: float


def fit(episodes: Sequence[Played]) -> Fit:
    """Fits judgement and hands.

    Args:
        episodes: of one person, or one team.

    Raises:
        ResultsError: one line, if there is too little to fit to.
    """
    shown = [one for one in episodes if one.judged[max(_DELAYS) :].any()]
    judged = sum(int(one.judged.sum()) for one in shown)
    if judged < _LEAST_STEPS or len(shown) < 3:
        raise ResultsError(
            f"{judged} judged steps of {len(shown)} episodes that are longer than {max(_DELAYS)} "
            f"steps: must be at least {_LEAST_STEPS} steps of 3 such episodes"
        )
    parts = _split(shown)
    keys = jax.random.split(jax.random.key(0))
    tried = {delay: _try_danger(parts, delay, keys[0]) for delay in _DELAYS}
    best = min(tried, key=lambda delay: tried[delay].loss)
    least = _threshold(tried[best].params, parts["choose"], best)
    network = _whole_danger(parts, best, tried[best], keys[0])
    seen, dangerous = _judgements(parts["test"], best)
    found = _probability(network, seen) >= least
    arrays = by_name({DANGER: network}) | {
        DELAY: np.array(best, np.int32),
        LEAST: np.array(least, np.float32),
    }
    hands, explained = _fit_hands(parts, keys[1])
    if hands is not None:
        arrays |= by_name({HANDS: hands})
    return Fit(
        arrays={name: np.asarray(array) for name, array in arrays.items()},
        delay=best,
        steps=len(seen),
        dangerous=_share(dangerous),
        agrees=_share(found == dangerous),
        missed=_share(~found[dangerous]),
        feared=_share(found[~dangerous]),
        hand_steps=sum(len(_in_hands(parts[name])[0]) for name in ("fit", "choose")),
        explained=explained,
    )


def _split(episodes: Sequence[Played]) -> dict[str, list[Played]]:
    """To fit to, to choose by, and to tell by; with few episodes one each to choose and tell by."""
    every = min(_EVERY, len(episodes))
    parts: dict[str, list[Played]] = {"fit": [], "choose": [], "test": []}
    for place, one in enumerate(episodes):
        parts[{0: "test", 1: "choose"}.get(place % every, "fit")].append(one)
    return parts


def _judgements(
    episodes: Sequence[Played], delay: int, first: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """States [N, O], and what was judged of each a delay later, from some step on, bool [N]."""
    seen, dangerous = [], []
    for one in episodes:
        steps = len(one.rewards)
        late = np.arange(max(delay, first), steps)
        kept = late[one.judged[late]]
        seen.append(one.observations[kept - delay])
        dangerous.append(one.dangerous[kept])
    return np.concatenate(seen), np.concatenate(dangerous)


class _Tried(NamedTuple):
    """A fit, stopped where it foretold other data best.

    Attributes:
        params: of the network.
        looks: how long it was fitted, in `_UPDATES`.
        loss: on the other data.
    """

    params: Params
    looks: int
    loss: float


def _try_danger(parts: dict[str, list[Played]], delay: int, key: chex.PRNGKey) -> _Tried:
    """The loss is of the same steps for all delays."""
    fit_to, choose_by = (
        _judgements(parts[name], delay, first=max(_DELAYS)) for name in ("fit", "choose")
    )
    return _try(RiskNetwork(_SIZES), optax.sigmoid_binary_cross_entropy, fit_to, choose_by, key)


def _whole_danger(
    parts: dict[str, list[Played]], delay: int, tried: _Tried, key: chex.PRNGKey
) -> Params:
    """As long a fit to all that is not held out."""
    data = _judgements([*parts["fit"], *parts["choose"]], delay)
    loss_of = optax.sigmoid_binary_cross_entropy
    return _fit_for(RiskNetwork(_SIZES), loss_of, data, tried.looks, key)


def _probability(network: Params, seen: np.ndarray) -> np.ndarray:
    logits: Any = RiskNetwork(_SIZES).apply(network, jnp.asarray(seen))
    return np.asarray(jax.nn.sigmoid(logits))


def _threshold(network: Params, episodes: Sequence[Played], delay: int) -> float:
    """The probability from which calling a state dangerous agrees best."""
    seen, dangerous = _judgements(episodes, delay)
    probability = _probability(network, seen)
    candidates = np.linspace(0.05, 0.95, 19, dtype=np.float32)
    agrees = [((probability >= least) == dangerous).mean() for least in candidates]
    return float(candidates[int(np.argmax(agrees))])


def _fit_hands(parts: dict[str, list[Played]], key: chex.PRNGKey) -> tuple[Params | None, float]:
    """Parameters of an `Actor`, and what it explains of the actions that were held out."""
    data = {name: _in_hands(episodes) for name, episodes in parts.items()}
    if len(data["fit"][0]) < _LEAST_HANDS or not len(data["choose"][0]):
        return None, float("nan")
    actor = Actor(_SIZES, data["fit"][1].shape[1])
    tried = _try(actor, optax.squared_error, data["fit"], data["choose"], key)
    whole = _in_hands([*parts["fit"], *parts["choose"]])
    params = _fit_for(actor, optax.squared_error, whole, tried.looks, key)
    seen, actions = data["test"]
    if len(seen) < 2:
        return params, float("nan")
    errors = np.asarray(actor.apply(params, jnp.asarray(seen))) - actions
    return params, float(1.0 - (errors**2).sum() / ((actions - actions.mean(0)) ** 2).sum())


def _in_hands(episodes: Sequence[Played]) -> tuple[np.ndarray, np.ndarray]:
    """States and actions of the steps in the person's hands, [N, O] and [N, A]."""
    seen = [one.observations[:-1][one.human_action] for one in episodes]
    actions = [one.actions[one.human_action] for one in episodes]
    return np.concatenate(seen), np.clip(np.concatenate(actions), -1.0, 1.0)


Data = tuple[np.ndarray, np.ndarray]
"""Inputs [N, I] and targets [N] or [N, A]."""
Loss = Callable[[chex.Array, chex.Array], chex.Array]


def _try(network: Any, loss_of: Loss, fit_to: Data, choose_by: Data, key: chex.PRNGKey) -> _Tried:
    seen, known = jnp.asarray(choose_by[0]), jnp.asarray(choose_by[1], jnp.float32)
    best = None
    for looks, params in enumerate(_fits(network, loss_of, fit_to, key), 1):
        loss = float(loss_of(network.apply(params, seen), known).mean())
        if best is None or loss < best.loss:
            best = _Tried(params, looks, loss)
    assert best is not None
    return best


def _fit_for(network: Any, loss_of: Loss, data: Data, looks: int, key: chex.PRNGKey) -> Params:
    *_, params = itertools.islice(_fits(network, loss_of, data, key), looks)
    return params


def _fits(network: Any, loss_of: Loss, data: Data, key: chex.PRNGKey) -> Iterator[Params]:
    """Parameters after each `_UPDATES` minibatches."""
    inputs, targets = jnp.asarray(data[0]), jnp.asarray(data[1], jnp.float32)
    first, key = jax.random.split(key)
    params = network.init(first, inputs[:1])
    state = params, adam.init(params)
    for look in range(_LOOKS):
        state = _fitted(network, loss_of, state, inputs, targets, jax.random.fold_in(key, look))
        yield state[0]


@functools.partial(jax.jit, static_argnums=(0, 1))
def _fitted(
    network: Any,
    loss_of: Loss,
    state: Any,
    inputs: chex.Array,
    targets: chex.Array,
    key: chex.PRNGKey,
) -> Any:
    """Parameters and optimiser after some more minibatches."""

    def loss(params: Params, index: chex.Array) -> chex.Array:
        return loss_of(network.apply(params, inputs[index]), targets[index]).mean()

    def step(state: Any, key: chex.PRNGKey) -> tuple[Any, None]:
        params, optimizer = state
        index = jax.random.randint(key, (_BATCH,), 0, len(inputs))
        grads = jax.grad(loss)(params, index)
        return adam.descend(params, grads, optimizer, jnp.float32(_LEARNING_RATE)), None

    after, _ = jax.lax.scan(step, state, jax.random.split(key, _UPDATES))
    return after


def _share(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")
