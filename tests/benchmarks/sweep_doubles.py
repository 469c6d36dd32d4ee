"""What stands in for engines in tests of the runner."""


def instant(run):
    """A record as a run would give it, without running anything."""
    done = "i1" in run.instance or "j1" in run.instance
    record = {
        "key": run.key,
        **run.to_dict(),
        "status": "SOLVED_OPTIMALLY" if done else "TIMEOUT",
        "seconds": 1.5,
        "versions": {"python": "3"},
        "machine": {"cores": 2},
    }
    if done:
        record |= {"valid": True, "violations": [], "makespan": 50, "sequential": 100}
        record["metrics"] = {"rounds": 3, "refinements_geometric": 1, "lower_bound": 50}
    else:
        record["error"] = "no plan | in time"
    return record
