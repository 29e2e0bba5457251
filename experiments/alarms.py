"""`hitl-jax alarms` from a checkout: `python -m experiments.alarms`."""

import sys

from hitl_jax.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["alarms", *sys.argv[1:]]))
