"""What is measured and never asserted: ``python -m tests.benchmarks``."""
