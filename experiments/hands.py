"""`hitl-jax hands` from a checkout: `python -m experiments.hands`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["hands", *sys.argv[1:]]))
