"""``python -m up_samp`` is ``up-samp``."""

import sys

from up_samp.cli import main

if __name__ == "__main__":
    sys.exit(main())
