"""`hitl-jax recorded` from a checkout: `python -m experiments.recorded`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["recorded", *sys.argv[1:]]))
