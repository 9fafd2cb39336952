"""rcbht-jax: from a wrench signal to words, a grammar and a belief about what the robot is doing."""

__version__ = "0.2.0"
