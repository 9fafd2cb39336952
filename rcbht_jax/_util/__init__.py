"""Helpers: atomic writes, digests, checkpoints, optional imports, CMA-ES, the compilation cache."""
