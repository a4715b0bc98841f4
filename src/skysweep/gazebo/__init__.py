"""Gazebo: worlds as SDF folders, and Gazebo's cameras as a mission's camera.

Uses the meshes and textures of ``worlds`` and knows nothing of the mission.
"""
