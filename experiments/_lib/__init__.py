"""What experiments share: benchmarks, raw-signal baselines, results on disk."""
