"""Settings that must come before JAX starts."""

import os

# Two CPU devices that learn and one that acts, as the sweep has on a machine of two cores.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "3")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Nothing of a test in the user's cache, nothing of the cache in a test.
os.environ.setdefault("JAX_ENABLE_COMPILATION_CACHE", "false")
