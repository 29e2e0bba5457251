"""`hitl-jax human` from a checkout: `python -m experiments.human`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["human", *sys.argv[1:]]))
