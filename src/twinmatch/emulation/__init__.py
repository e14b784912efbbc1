"""The rig without the rig: a camera and an Arduino behind the real protocols."""
