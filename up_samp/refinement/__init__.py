"""From a failed motion check to refinements."""
