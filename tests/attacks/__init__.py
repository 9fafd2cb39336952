"""Attacks with generated files, targets and streams: ``python -m tests.attacks`` is the long form."""
