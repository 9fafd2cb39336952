"""The ``rcbht`` command line; see :mod:`rcbht_jax.cli.command`."""
