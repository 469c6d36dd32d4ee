"""Pure functions from motion reports to refinements."""

from up_samp.refinement import rules, timed
from up_samp.refinement.evaluate import holds

__all__ = ["holds", "rules", "timed"]
