"""The program at the thermal camera: takes frames from a source and serves them over TCP.

`sources` has the cameras behind one small interface, `broadcast` hands the newest frame to every
client, `program` joins the two, `emulation` has an emulated camera, `__main__` is the command line. It runs
without ROS; from twinmatch it uses the frame type and codec (`twinmatch.links.thermal_frame`).
"""

__version__ = "0.1.0"
