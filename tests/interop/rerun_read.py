"""Opens a bag with Rerun's reader and our blueprint, without a window, and prints its contents as JSON.

    python rerun_read.py BLUEPRINT.py BAG

{entity: {component: rows}}: an entity is a topic, a component what Rerun shows of it. A number of std_msgs has the
component COMPONENT.data too, if the blueprint's selector finds numbers there.
"""

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

from rerun.chunk import RrdReader


def main(blueprint, bag):
    with tempfile.TemporaryDirectory() as folder:
        saved = Path(folder) / "bag.rrd"
        subprocess.run([sys.executable, blueprint, bag, "--save", saved], check=True)
        reader = RrdReader(saved)
        assert len(reader.recordings()) == 1, reader.recordings()
        assert len(reader.blueprints()) == 1, reader.blueprints()
        rows = defaultdict(lambda: defaultdict(int))
        for chunk in reader.stream():
            # The others are Rerun's own: row ids and times.
            for component in (name for name in chunk.to_record_batch().schema.names if ":" in name):
                rows[chunk.entity_path][component] += chunk.num_rows
                if component.startswith("std_msgs.msg.Float"):
                    data = chunk.apply_selector(component, ".data").to_record_batch().column(component)
                    numbers = [number for number in data.flatten().to_pylist() if isinstance(number, float)]
                    rows[chunk.entity_path][f"{component}.data"] += len(numbers)
    json.dump(rows, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
