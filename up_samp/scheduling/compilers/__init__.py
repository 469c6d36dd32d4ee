"""Compilers: passes over :class:`PlainProblem`, each with a map back for schedules."""
