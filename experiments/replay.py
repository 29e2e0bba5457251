"""`hitl-jax replay` from a checkout: `python -m experiments.replay`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["replay", *sys.argv[1:]]))
