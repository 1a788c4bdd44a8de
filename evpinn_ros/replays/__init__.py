"""Replays recorded drives through the chain, and scores them."""
