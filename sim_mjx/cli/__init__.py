"""The commands of ``rcbht`` that simulate; entered by name in the table of ``rcbht_jax.cli.main``."""
