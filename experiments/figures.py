"""`hitl-jax figures` from a checkout: `python -m experiments.figures`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["figures", *sys.argv[1:]]))
