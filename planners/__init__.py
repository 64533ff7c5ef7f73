"""How to search: sampling planners in numpy. Empty of imports, so that `python -m planners.NAME` is clean."""
