"""Environments as users make them; the workers import this file by `module:id` names."""

import itertools
import time

import gymnasium
import numpy as np
from gymnasium.envs.registration import WrapperSpec
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary
from gymnasium.wrappers import NormalizeObservation, NormalizeReward

WHOLE = Box(-np.inf, np.inf, (2,), np.float32)
UNIT = Box(-1.0, 1.0, (2,), np.float32)


def low_gravity():
    """A walker on the moon; made here, since the tests' own process must not import Box2D."""
    from Box2D import b2World
    from gymnasium.envs.box2d.bipedal_walker import BipedalWalker

    class LowGravity(BipedalWalker):
        def __init__(self):
            super().__init__()
            self.world = b2World(gravity=(0, -1.6))

    return LowGravity()


def no_sleep():
    """A walker whose world has another setting."""
    from Box2D import b2World
    from gymnasium.envs.box2d.bipedal_walker import BipedalWalker

    class NoSleep(BipedalWalker):
        def __init__(self):
            super().__init__()
            self.world = b2World(doSleep=False, gravity=(1.0, -10.0))

    return NoSleep()


class Drift(gymnasium.Env):
    """A point that drifts: observation (place, steps)."""

    observation_space = WHOLE
    action_space = UNIT

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.steps = self.np_random.normal(), 0
        return self.observe(), {}

    def step(self, action):
        self.steps += 1
        self.place += 0.1 * float(action[0]) + 0.1 * self.np_random.normal()
        return self.observe(), self.place, self.steps == 50, False, {}

    def observe(self):
        return np.array([self.place, self.steps], np.float32)


class Smoothed(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Has a state, which begins anew with each episode."""

    def __init__(self, env, share=0.5):
        gymnasium.utils.RecordConstructorArgs.__init__(self, share=share)
        super().__init__(env)
        self.share = share

    def reset(self, *, seed=None, options=None):
        self.last, info = self.env.reset(seed=seed, options=options)
        return self.last, info

    def step(self, action):
        seen, *rest = self.env.step(action)
        self.last = (self.share * self.last + (1 - self.share) * seen).astype(np.float32)
        return self.last, *rest


class RunningReward(gymnasium.Wrapper):
    """Divides rewards by the number of all steps so far."""

    steps = 0

    def step(self, action):
        self.steps += 1
        seen, reward, *rest = self.env.step(action)
        return seen, 1.0 + reward / self.steps, *rest


class RunningLargest(gymnasium.Wrapper):
    """A scale of one's own that runs through all episodes."""

    largest = 0.0

    def reset(self, **given):
        seen, info = self.env.reset(**given)
        return self.scaled(seen), info

    def step(self, action):
        seen, *rest = self.env.step(action)
        return self.scaled(seen), *rest

    def scaled(self, seen):
        self.largest = max(self.largest, float(np.abs(seen).max()))
        return (seen / self.largest).astype(np.float32)


class Harder(Drift):
    """Begins farther away in each episode."""

    episodes = 0

    def reset(self, **given):
        self.episodes += 1
        _, info = super().reset(**given)
        self.place += self.episodes
        return self.observe(), info


class Counted(Drift):
    """As `Harder`, but all environments share the count."""

    numbers = itertools.count()

    def reset(self, **given):
        super().reset(**given)
        self.place += next(self.numbers)
        return self.observe(), {}


class Unseeded(Drift):
    """Draws from NumPy's global numbers, which nobody seeds."""

    def reset(self, **given):
        super().reset(**given)
        self.place = np.random.normal()  # noqa: NPY002
        return self.observe(), {}


class Clock(Drift):
    """Tells the nanoseconds: float32 does not tell two times apart after days without a restart."""

    def observe(self):
        return np.array([self.place, time.perf_counter_ns() % 10**6], np.float32)


class Misshapen(Drift):
    """An observation of one number would be written to all places."""

    def observe(self):
        return np.array([self.place], np.float32)


class Wide(Drift):
    """Observations of float64 and whole numbers."""

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)

    def observe(self):
        return np.array([self.place, self.steps], np.float64)


class RewardInArray(Drift):
    """Its reward is an array of one number."""

    def step(self, action):
        seen, reward, *rest = super().step(action)
        return seen, np.array([reward]), *rest


class Whole(Drift):
    """Observations of int64."""

    observation_space = Box(-100, 100, (2,), np.int64)

    def observe(self):
        return np.array([round(10 * self.place), self.steps])


class KeepsAction(Drift):
    """Keeps the array that it was given and compares it with the next; changes it in place."""

    def reset(self, *, seed=None, options=None):
        self.before = np.zeros(2, np.float32)
        return super().reset(seed=seed)

    def step(self, action):
        change = float(np.abs(action - self.before).sum())
        self.before = action
        seen, _, *rest = super().step(action)
        action *= 0.5
        return seen, change, *rest


class Echo(gymnasium.Env):
    """Observes the action that it was given, and whether it had its space's type."""

    def __init__(self, box):
        self.action_space = box
        size = int(np.prod(box.shape, dtype=int)) + 1
        self.observation_space = Box(-np.inf, np.inf, (size,), np.float32)

    def reset(self, *, seed=None, options=None):
        return np.zeros(self.observation_space.shape, np.float32), {}

    def step(self, action):
        typed = action.dtype == self.action_space.dtype
        return np.array([*action, typed], np.float32), 0.0, False, False, {}


class Seen(Drift):
    """Has another space of observations."""

    def __init__(self, space):
        self.observation_space = space


BOXES = {
    "Unit": UNIT,
    "Torque": Box(-2.0, 2.0, (1,), np.float32),
    "Positive": Box(0.0, 3.0, (2,), np.float32),
    "Each": Box(np.float32([-1, 0, -0.3, 5]), np.float32([1, 3, 0.1, 5]), dtype=np.float32),
    "Fine": Box(-0.4, 0.7, (1,), np.float64),
    "FineUnit": Box(-1.0, 1.0, (1,), np.float64),
    "Huge": Box(-3e38, 3e38, (1,), np.float32),
}
REFUSED_BOXES = {
    "Unbounded": Box(-np.inf, np.inf, (1,), np.float32),
    "HalfBounded": Box(np.float32([0, -1]), np.float32([np.inf, 1]), dtype=np.float32),
    "Integers": Box(0, 255, (2,), np.uint8),
    "Choice": Discrete(3),
    "Switches": MultiBinary(4),
    "Matrix": Box(-1.0, 1.0, (2, 2), np.float32),
    "Scalar": Box(-1.0, 1.0, (), np.float32),
    "Nothing": Box(-1.0, 1.0, (0,), np.float32),
}
REFUSED_VIEWS = {
    "Image": Box(0, 255, (4, 4, 3), np.uint8),
    "Parts": Dict({"place": UNIT}),
    "Number": Discrete(5),
}


def wrapped(*wrappers):
    """An entry point that wraps."""

    def make():
        env = Drift()
        for wrapper in wrappers:
            env = wrapper(env)
        return env

    return make


def settled():
    """Statistics that were found before, and run no more."""
    env = NormalizeObservation(Drift())
    env.obs_rms.mean, env.obs_rms.var = np.array([0.5, 25.0]), np.array([4.0, 100.0])
    env.update_running_mean = False
    return env


gymnasium.register("LowGravity-v0", low_gravity, max_episode_steps=60)
gymnasium.register("NoSleep-v0", no_sleep)
gymnasium.register(
    "Moon-v0",
    "gymnasium.envs.box2d.lunar_lander:LunarLander",
    kwargs={"continuous": True, "gravity": -3.0, "enable_wind": True},
    max_episode_steps=80,
)
gymnasium.register(
    "SmoothedLow-v0",
    low_gravity,
    additional_wrappers=(WrapperSpec("Smoothed", "own_envs:Smoothed", {"share": 0.3}),),
)
gymnasium.register("Wrapped-v0", wrapped(Smoothed, Smoothed))
gymnasium.register("Settled-v0", settled)
gymnasium.register(
    "NormalObservation-v0",
    Drift,
    additional_wrappers=(
        WrapperSpec(
            "NormalizeObservation", "gymnasium.wrappers:NormalizeObservation", {"epsilon": 1e-8}
        ),
    ),
)
gymnasium.register("NormalReward-v0", wrapped(NormalizeReward, Smoothed))
gymnasium.register("RunningLargest-v0", wrapped(RunningLargest))
gymnasium.register("RunningReward-v0", wrapped(RunningReward))
_KINDS = (Harder, Counted, Unseeded, Clock, Misshapen, Wide, Whole, RewardInArray, KeepsAction)
for kind in _KINDS:
    gymnasium.register(f"{kind.__name__}-v0", kind)
for name, box in (BOXES | REFUSED_BOXES).items():
    gymnasium.register(f"{name}-v0", Echo, kwargs={"box": box})
for name, view in REFUSED_VIEWS.items():
    gymnasium.register(f"{name}-v0", Seen, kwargs={"space": view})
gymnasium.register("NoMujoco-v0", "a_simulator_that_is_not_there:Env")
