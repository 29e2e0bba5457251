"""`hitl-jax ablation` from a checkout: `python -m experiments.ablation`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["ablation", *sys.argv[1:]]))
