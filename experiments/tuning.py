"""`hitl-jax tuning` from a checkout: `python -m experiments.tuning`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["tuning", *sys.argv[1:]]))
