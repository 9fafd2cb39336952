"""Streamed beliefs, detected onsets, faults and latency."""
