"""Write the JSON Schema of problem files anew: ``python scripts/schema.py``, after the records
(up_samp/fleet/records.py) have changed.
"""

import json
from pathlib import Path

from up_samp.fleet.files import json_schema

FILE = Path(__file__).parents[1] / "up_samp" / "fleet" / "problem.schema.json"

if __name__ == "__main__":
    FILE.write_text(json.dumps(json_schema(), indent=1) + "\n", encoding="utf-8")
    print(FILE)
