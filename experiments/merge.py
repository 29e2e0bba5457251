"""`hitl-jax merge` from a checkout: `python -m experiments.merge`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["merge", *sys.argv[1:]]))
