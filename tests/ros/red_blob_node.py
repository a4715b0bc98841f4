"""Somebody else's detector: plain rclpy, nothing of skysweep. Calls the red pixels of a picture a stop sign.

Publishes the standard form of detections (MarkerArray).
"""

import numpy as np
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
from visualization_msgs.msg import Marker, MarkerArray


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("red_blob")
    publisher = node.create_publisher(MarkerArray, "/blobs", 10)

    def look(picture: Image) -> None:
        pixels = np.frombuffer(picture.data, np.uint8).reshape(picture.height, picture.width, 3).astype(int)
        red, green, blue = np.moveaxis(pixels, 2, 0)
        ys, xs = np.nonzero((red > 110) & (red > 2 * green) & (red > 2 * blue))
        answer = MarkerArray(markers=[Marker(header=picture.header, action=Marker.DELETEALL)])
        if len(xs) > 3:
            blob = Marker(header=picture.header, type=Marker.CUBE, text="stop sign")
            blob.pose.position.x = float(xs.min() + xs.max() + 1) / 2
            blob.pose.position.y = float(ys.min() + ys.max() + 1) / 2
            blob.scale.x, blob.scale.y = float(np.ptp(xs) + 1), float(np.ptp(ys) + 1)
            blob.color.a = 0.9
            answer.markers.append(blob)
        publisher.publish(answer)

    node.create_subscription(Image, "/skysweep/camera/image_raw", look, qos_profile_sensor_data)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
