"""Connections to the hardware, without ROS: the camera's thermal stream, serial lines to board and kit."""
