"""The simulated cell: a plausible world, its pictures, arm and gripper, and a simulated PLC."""
