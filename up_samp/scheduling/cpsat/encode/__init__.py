"""From a scheduling problem to CP-SAT variables and constraints."""
