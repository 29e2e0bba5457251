"""The walker's programs for NVIDIA GPUs: kernels, and a solver with four threads for each walker.

What is traced for a GPU differs where `hitl_jax.xla.gpu.on_gpu` is asked.
"""
