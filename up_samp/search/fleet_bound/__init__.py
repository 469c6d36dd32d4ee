"""Lower bounds of large problems: all jobs shared by all robots as evenly as can be."""
