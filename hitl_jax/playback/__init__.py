"""Episodes of a results folder played again, and films of them."""
