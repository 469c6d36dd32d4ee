"""How a model is solved: the order of stages, options of CP-SAT, one run."""
