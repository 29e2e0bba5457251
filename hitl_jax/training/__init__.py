"""Many runs trained side by side: the batch, the host loop, and runs that wait on disk."""
