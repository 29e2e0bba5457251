"""The task learner: losses, networks, replay, and the algorithms that a name stands for."""
