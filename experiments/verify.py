"""`hitl-jax verify` from a checkout: `python -m experiments.verify`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["verify", *sys.argv[1:]]))
