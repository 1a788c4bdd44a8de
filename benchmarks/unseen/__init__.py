"""Prediction without the battery, scored on recorded and simulated drives.

Every method sees the same readings and is scored on the same samples; the battery readings that it
is scored against never reach it. See `docs/project/benchmarks.md`, "Unseen".
"""
