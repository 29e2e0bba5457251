"""`hitl-jax brax-ppo` from a checkout: `python -m experiments.brax_ppo`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["brax-ppo", *sys.argv[1:]]))
