"""The wires, without ROS: the thermal stream from the camera and the serial line to the Arduino."""
