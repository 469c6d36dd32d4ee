"""UP's view of the package: the meta-engine, the scheduler, the validator, and registration."""
