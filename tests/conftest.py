"""Settings that must come before JAX starts."""

import os

# Two CPU devices, as the sweep has on a machine of two cores: sharding is tested as it is used.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
