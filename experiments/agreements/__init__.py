"""Parts of `python -m experiments.agreement`."""
