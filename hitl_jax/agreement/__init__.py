"""The walker in JAX beside Box2D's: states, returns, trained walkers."""
