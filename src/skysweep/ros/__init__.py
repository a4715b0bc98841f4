"""ROS 2: a mission on topics, and other nodes as parts of a mission.

``interfaces``, ``messages``, ``topics`` and ``targets`` need no ROS; the rest needs rclpy, from a ROS 2
installation or from the extra ``ros``.
"""
