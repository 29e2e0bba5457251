"""The task learners, for tests that compile programs of each: the default's first, others slow."""

import pytest

LEARNERS = ("td3-tqc", *(pytest.param(name, marks=pytest.mark.slow) for name in ("td3", "ddpg")))
