"""Settings that must come before JAX starts."""

import os

# The devices that learn on a machine of two cores, whatever this one has.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Nothing of a test in the user's cache, nothing of the cache in a test.
os.environ.setdefault("JAX_ENABLE_COMPILATION_CACHE", "false")
