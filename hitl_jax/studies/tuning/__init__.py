"""What a learner's configuration costs and gives."""
