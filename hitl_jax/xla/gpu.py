from hitl_jax.walker.gpu import default_device, on_gpu  # placeholder until merged
