"""`hitl-jax participants` from a checkout: `python -m experiments.participants`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["participants", *sys.argv[1:]]))
