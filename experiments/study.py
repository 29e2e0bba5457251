"""`hitl-jax study` from a checkout: `python -m experiments.study`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["study", *sys.argv[1:]]))
