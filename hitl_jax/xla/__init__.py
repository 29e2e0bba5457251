"""What we do to please a compiler, and nothing that changes a result."""
