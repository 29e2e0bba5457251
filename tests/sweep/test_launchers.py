"""How a sweep is divided among machines."""

import asyncio

import numpy as np
import pytest

from hitl_jax.config import Hyper, Method, hyper_for
from hitl_jax.errors import LaunchError
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep import shards, train_and_test
from hitl_jax.sweep.launchers.cluster import Places, divided, places_of
from hitl_jax.sweep.launchers.machine import Inbox
from hitl_jax.sweep.shards import Shard
from hitl_jax.sweep.train_and_test import Batch, Walkers
from hitl_jax.training.run_spec import FinishedRun, LoopConfig, Run, RunSpec


def _machine(cpus, gpus=0, alive=True):
    resources = {"CPU": float(cpus), "GPU": float(gpus), "memory": 1e9}
    return {"Alive": alive, "Resources": {name: n for name, n in resources.items() if n}}


@pytest.mark.parametrize(
    ("machines", "places"),
    [
        ([_machine(2)], Places(1, 2, 0, 0)),
        ([_machine(0), _machine(4), _machine(4)], Places(2, 4, 0, 0)),
        ([_machine(4), _machine(4, alive=False)], Places(1, 4, 0, 0)),
        # A larger one takes as many groups as it has room for; for a small one none is made small.
        ([_machine(4), _machine(4), _machine(16)], Places(6, 4, 0, 0)),
        ([_machine(1), _machine(64), _machine(64)], Places(2, 64, 0, 1)),
        # Where there are GPUs, a group takes one, and its share of the cores.
        ([_machine(16, gpus=4), _machine(8)], Places(4, 4, 1, 1)),
        ([_machine(16, gpus=4), _machine(8, gpus=8)], Places(12, 1, 1, 0)),
        # Unless nobody could feed them.
        ([_machine(0, gpus=1), _machine(8)], Places(1, 8, 0, 0)),
        ([_machine(2, gpus=4), _machine(64)], Places(1, 64, 0, 1)),
    ],
)
def test_a_group_takes_a_machine(machines, places):
    assert places_of(machines) == places


def test_a_run_that_is_made_twice_comes_once():
    def tested(key):
        run = Run(RunSpec(Method.SRL, key.seed, hyper_for(Method.SRL, Hyper()), 1), 0)
        return train_and_test.Tested(FinishedRun(run, {}, np.zeros(())), [], [], 1.0, "", {}, "")

    async def attempts():
        inbox, keys = Inbox(), [RunKey("srl", 0), RunKey("srl", 1)]
        first = await inbox.begin(7, "a", keys)
        await inbox.put(tested(keys[0]))
        again = await inbox.begin(7, "b", keys)
        for key in (keys[0], keys[1], keys[1]):
            await inbox.put(tested(key))
        assert (first.attempt, first.keys) == (1, keys)
        assert (again.attempt, again.keys) == (2, keys[1:])
        messages = await inbox.take(1.0)
        assert [one.key for one in messages if isinstance(one, train_and_test.Tested)] == keys
        assert await inbox.take(0.0) == []

    asyncio.run(attempts())


def test_a_cluster_without_cores_is_refused():
    with pytest.raises(LaunchError, match="no machine with a core for us"):
        places_of([_machine(0)])


def _batch(name, runs, slots=32):
    hyper = hyper_for(Method.SRL, Hyper())
    specs = [RunSpec(Method.SRL, seed, hyper, 1) for seed in range(runs)]
    return Batch(name, None, specs, LoopConfig(), Walkers("lean", slots, None, 1))


@pytest.mark.parametrize(
    ("runs", "places", "sizes"),
    [
        ([30], 1, [30]),
        ([30], 4, [7, 8, 7, 8]),
        ([3], 10, [1, 1, 1]),
        ([3000], 10, [30] * 100),  # In ten full rounds, not in nine and a part.
        ([20, 10], 3, [10, 10, 10]),
        ([5, 0], 2, [2, 3]),
        ([0], 4, []),
    ],
)
def test_groups_are_of_a_size_and_leave_no_machine_idle(runs, places, sizes):
    batches = [_batch(f"batch {number}", count) for number, count in enumerate(runs)]
    groups = divided(batches, places)
    assert [len(group.specs) for group in groups] == sizes
    for batch in batches:
        mine = [spec for group in groups if group.name == batch.name for spec in group.specs]
        assert mine == batch.specs


@pytest.mark.parametrize("text", ["", "3", "0/4", "5/4", "1/0", "-1/4", "a/b", "1/2/3", "1.5/4"])
def test_what_is_no_shard_is_refused(text):
    with pytest.raises(ValueError, match=r"shard .*: must be NUMBER/OF, for example 3/16"):
        shards.parse(text)


def test_shards_are_the_whole():
    assert shards.parse("3/16") == (3, 16)
    parts = [Shard(number, 4, ["srl", "hitl-ac"], 5, 3).runs() for number in range(1, 5)]
    assert [len(part) for part in parts] == [1, 2, 1, 2]
    whole = [RunKey(method, seed) for seed in (5, 6, 7) for method in ("srl", "hitl-ac")]
    assert [key for part in parts for key in part] == whole
