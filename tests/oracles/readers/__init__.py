"""Readers that share nothing with gonio: what foreign programs find in its files, one pair of directions at a time."""
