"""Grippers: on outputs of the arm, and Robotiq over its URCap."""
