"""Gazebo: our worlds as SDF folders, and its cameras as a mission's camera.

Stands on floor 3 beside sensing, whose meshes, textures and camera it uses; of the mission it knows nothing,
and only ``flights/build.py`` and the command line import it.
"""
