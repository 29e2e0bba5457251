"""`hitl-jax import` from a checkout: `python -m experiments.import_human`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["import", *sys.argv[1:]]))
