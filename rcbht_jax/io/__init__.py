"""The store of recordings, readers of recorded trials and streams, and exporters."""
