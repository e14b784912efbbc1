"""Run the twin beside a rig that is already running. It subscribes only and commands nothing. Ctrl-C ends it.

    python launch_scripts/attach.py --config my_rig.yaml [--twin-config my_twin.yaml] [--session FOLDER]
    python launch_scripts/attach.py --plant plant.py --map reference=/sp output=/t:temperature input=/cmd

Add --dashboard for a live page. config/attach.yaml explains the entries of the configuration file.

Exit code: 0 ended as requested, 1 the session could not be written, 2 an option or a file cannot be used or
is missing, 3 a process could not be kept running.
"""

from __future__ import annotations

import sys

from twinmatch.cli import main

if __name__ == "__main__":
    sys.argv[1:1] = ["attach"]
    sys.exit(main())
