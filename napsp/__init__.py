"""Neural all-pairs shortest paths: learned distances d(s, a, g) and the policies they train."""
