"""Human-in-the-loop actor-critic with a learned switching boundary (HITL-AC), in JAX."""
