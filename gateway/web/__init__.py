"""The read-only web side: health and metrics."""
