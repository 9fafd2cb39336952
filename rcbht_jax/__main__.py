"""``python -m rcbht_jax``: the ``rcbht`` command without an installed script."""

from rcbht_jax.cli.main import script

if __name__ == "__main__":
    script()
