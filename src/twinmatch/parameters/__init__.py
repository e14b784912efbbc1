"""Parameters as users write them: names, defaults, units and ranges, and what they define.

`declared` has the table entry of a parameter and the check of given values; `twin` has the tables of the
running loop and of the twin, and the settings that checked values define. They are read from a ROS parameter
file or from a recorded session, so nothing here needs ROS: live nodes and offline work share them.
"""
