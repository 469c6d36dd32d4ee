"""Routes inside a scheduling problem: detection, bounds, quick schedules."""
