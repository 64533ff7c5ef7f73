"""What acts, and what trains it."""
