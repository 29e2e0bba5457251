"""The version for GPUs with four threads per walker. It compiles; it has not run on a GPU."""
