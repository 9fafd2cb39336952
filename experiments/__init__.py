"""Re-runnable experiments: each module writes one JSON result under ``experiments/results``."""
