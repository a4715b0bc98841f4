"""Gazebo: our worlds as SDF folders, and its cameras as a mission's camera.

Stands on worlds, whose meshes and textures it uses; of the mission it knows nothing.
"""
