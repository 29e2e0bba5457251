"""`hitl-jax benchmark` from a checkout: `python -m experiments.benchmark`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["benchmark", *sys.argv[1:]]))
