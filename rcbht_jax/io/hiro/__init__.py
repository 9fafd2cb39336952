"""Import of the authors' trial folders (robot HIRO)."""
