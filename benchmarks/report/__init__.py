"""One page with all results: ``python -m benchmarks.report``."""
