"""Episodes: collecting, keeping and sampling them."""
