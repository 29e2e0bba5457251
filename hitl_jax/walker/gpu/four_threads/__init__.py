"""What has not run on a GPU: four threads that share a walker, small blocks, other sines."""
