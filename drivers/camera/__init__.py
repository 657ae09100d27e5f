"""Cameras: recorded pairs, and two cameras as one stereo rig."""
