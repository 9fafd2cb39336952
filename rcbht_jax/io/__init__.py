"""Readers of recorded trials and the store they are kept in."""
