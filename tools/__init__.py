"""Programs that make the documentation; not part of the library."""
