"""`hitl-jax export` from a checkout: `python -m experiments.export`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["export", *sys.argv[1:]]))
