"""Proofs: motions that are impossible, and durations that no motion beats."""
