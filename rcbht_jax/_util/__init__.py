"""Helpers that know nothing of wrenches: atomic writes, digests, optional imports, CMA-ES, the compilation cache."""
