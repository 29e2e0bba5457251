"""Compiled programs, kept from one start to the next."""

import contextlib
import os
import pathlib

import jax


def keep_programs() -> None:
    """Keeps compiled programs in the user's cache folder; called before the first array is made.

    JAX_COMPILATION_CACHE_DIR names another folder; JAX_ENABLE_COMPILATION_CACHE=false keeps none;
    JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS goes before the threshold here. Where there is no
    home, nothing is kept.
    """
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        with contextlib.suppress(RuntimeError):
            cache = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
            jax.config.update("jax_compilation_cache_dir", str(pathlib.Path(cache) / "hitl_jax"))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        # JAX's own default keeps only what took a second to compile.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
