"""One run of the human-machine team: its parts, how it acts, how it learns."""
