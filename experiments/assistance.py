"""`hitl-jax assistance` from a checkout: `python -m experiments.assistance`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["assistance", *sys.argv[1:]]))
