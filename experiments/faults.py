"""`hitl-jax faults` from a checkout: `python -m experiments.faults`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["faults", *sys.argv[1:]]))
