"""A network learns from unlabelled photographs of its user's own cell (docs/adapt.md)."""
