"""Emulated hardware behind the real protocols: Arduino, Temperature Control Lab, and a camera led in step."""
