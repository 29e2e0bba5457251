"""`hitl-jax sweep` from a checkout: `python -m experiments.seed_sweep`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["sweep", *sys.argv[1:]]))
