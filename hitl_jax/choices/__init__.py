"""What can be chosen: registries by kind, the bounds of numbers, and how both are checked."""
