"""Lower bounds of large problems: all jobs assigned to robots as evenly as can be."""
