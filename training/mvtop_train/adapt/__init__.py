"""Training on unlabelled photographs of the user's cell (docs/tutorials/your-photographs.md)."""
