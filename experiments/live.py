"""`hitl-jax live` from a checkout: `python -m experiments.live`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["live", *sys.argv[1:]]))
