"""The parts of `python -m experiments.ablation`."""
