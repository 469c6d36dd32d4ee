"""Routes inside a scheduling problem: detection, relaxation, quick schedules."""
