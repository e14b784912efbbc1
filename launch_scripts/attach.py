"""Run the twin beside a rig that runs already: its topics are heard, nothing is commanded. Ends by Ctrl-C.

    python launch_scripts/attach.py --config my_rig.yaml [--twin-config my_twin.yaml] [--session FOLDER]
    python launch_scripts/attach.py --plant plant.py --map reference=/sp output=/t:temperature input=/cmd

Add --dashboard for a live page. config/attach.yaml says what may stand in the file.

Exit code: 0 ended as asked, 2 something given cannot be used or is not there, 3 a process was lost for good.
"""

from __future__ import annotations

import sys

from twinmatch.cli import main

if __name__ == "__main__":
    sys.exit(main(["attach", *sys.argv[1:]]))
