"""ROS 2: a mission on topics, and other people's nodes as parts of a mission.

``interfaces``, ``messages``, ``topics`` and ``targets`` need no ROS; the rest needs rclpy, of a ROS 2
installation or of the extra ``ros``.
"""
