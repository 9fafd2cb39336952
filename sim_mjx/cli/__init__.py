"""The commands of ``rcbht`` that simulate; see :mod:`sim_mjx.cli.commands`."""
