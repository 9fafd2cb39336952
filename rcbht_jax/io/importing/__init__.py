"""Recordings of any robot from files of any common format; :mod:`rcbht_jax.io.importing.importer` is the entry."""
