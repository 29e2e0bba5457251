"""What people and walkers did, in formats that other libraries read."""
