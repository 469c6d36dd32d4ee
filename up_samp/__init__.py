"""Scheduling And Motion Planning (SAMP) as a plugin of Unified Planning."""

__version__ = "0.1.0"
