"""Data sets on disk, and the batches that a network is trained on. Renders nothing."""
