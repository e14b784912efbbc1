"""What tests of several rooms need: waiting, processes, boards, rigs, steps, ROS."""
