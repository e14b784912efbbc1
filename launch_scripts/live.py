"""Run the twin beside a plant: bridges, controller, twin and recorder, until Ctrl-C or the profile's end.

    python launch_scripts/live.py --config config/rig.yaml [--session FOLDER]
    python launch_scripts/live.py --plant tclab [--port /dev/ttyACM0]
    python launch_scripts/live.py [--plant tclab] --virtual [--speed 20] [--fault drive-lost@300]

Add --dashboard [--control] to any of them for a live page.

Exit code: 0 ended as requested, 1 the session could not be written (see --keep-driving), 2 an option or a
file cannot be used, 3 the rig's process was lost. After 1 and 3 the output is off.
"""

from __future__ import annotations

import sys

from twinmatch.cli import main

if __name__ == "__main__":
    sys.argv[1:1] = ["live"]
    sys.exit(main())
