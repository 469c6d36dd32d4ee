"""Guides of searches: costs to go, search spaces, visibility, a heap. They prove nothing."""
