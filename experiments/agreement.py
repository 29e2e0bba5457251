"""`hitl-jax agreement` from a checkout: `python -m experiments.agreement`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["agreement", *sys.argv[1:]]))
