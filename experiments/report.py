"""`hitl-jax report` from a checkout: `python -m experiments.report`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["report", *sys.argv[1:]]))
