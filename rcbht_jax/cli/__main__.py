"""``python -m rcbht_jax.cli``: the ``rcbht`` command without an installed script."""

import sys

from rcbht_jax.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
