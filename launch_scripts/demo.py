"""See twinmatch work.

    python launch_scripts/demo.py                 # the live graph on a virtual rig, faster than real time
    python launch_scripts/demo.py SESSION         # a recorded session through the ROS graph
    python launch_scripts/demo.py --dashboard     # with the live page, which stays until Ctrl-C

The live demonstration is recorded, and the recording judged again. Both write a report at the end.
"""

from __future__ import annotations

import sys

from twinmatch.cli import main

if __name__ == "__main__":
    sys.argv[1:1] = ["demo"]
    sys.exit(main())
