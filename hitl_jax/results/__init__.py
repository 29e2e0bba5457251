"""What is on disk, and how it is checked when it is read; NumPy alone."""
