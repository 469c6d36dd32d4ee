"""Faults around a solve: what is injected, what must come of it, what must not be left."""
