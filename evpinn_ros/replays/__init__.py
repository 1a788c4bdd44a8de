"""Recorded drives through the chain, and their scores."""
