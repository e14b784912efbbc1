"""Emulated hardware behind the real protocols: camera, Arduino, and Temperature Control Lab."""
