"""Training side of mvtop: data, network, training, export and parity fixtures."""
