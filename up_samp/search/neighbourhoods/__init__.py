"""Large-neighbourhood search: a plan gets better where something of it is decided anew.

The scheduler of a whole problem with dozens of robots mostly says the same after a minute as after
ten seconds. So, once there is a plan, some robots (in some time) are freed, what the others do and
in which order is kept, and the small problem that is left is scheduled; its motions are checked
like those of any candidate. Which robots and when is chosen by several *neighbourhoods*
(:mod:`.choices`), the more often the more they brought (:mod:`.descent`). What such a problem has
no better schedule for says nothing of the whole: no bound comes from here.

After Shaw (1998), "Using constraint programming and local search methods to solve vehicle routing
problems"; Ropke and Pisinger (2006), "An adaptive large neighborhood search heuristic for the
pickup and delivery problem with time windows"; Godard, Laborie and Nuijten (2005), "Randomized
large neighborhood search for cumulative scheduling" (the order of what is kept); Li et al. (2021),
"Anytime multi-agent path finding via large neighborhood search" (robots that are in each other's
way).
"""

from up_samp.search.neighbourhoods.choices import CHOICES, Choice, Freed
from up_samp.search.neighbourhoods.descent import Descent, DescentSettings, Roulette

__all__ = ["CHOICES", "Choice", "Descent", "DescentSettings", "Freed", "Roulette"]
