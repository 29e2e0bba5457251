"""Values that a caller chooses: how they are checked."""
