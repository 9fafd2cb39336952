"""The words themselves: how well they describe the signal, and when they arrive."""
