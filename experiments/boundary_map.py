"""`hitl-jax boundary-map` from a checkout: `python -m experiments.boundary_map`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["boundary-map", *sys.argv[1:]]))
