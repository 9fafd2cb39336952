"""Figures of the committed results; nothing is measured here."""
