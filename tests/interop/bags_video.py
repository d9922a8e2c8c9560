"""Compares the frames of an imported bag with their video, decoded by FFmpeg (PyAV).

    python bags_video.py VIDEO.mp4 BAG [TOPIC]

Needs `av`, `opencv-python-headless`, `rosbags`. Prints JSON: {"video_frames": n, "bag_frames": n, "psnr_min": dB,
"psnr_mean": dB} over RGB; a bag's frames went through JPEG, and two decoders need not upsample chroma alike.
"""

import json
import math
import sys

import av
import cv2
import numpy
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore


def main(video, bag, topic="/camera/image_raw/compressed"):
    with av.open(video) as container:
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    store = get_typestore(Stores.ROS2_KILTED)
    with Reader(bag) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        images = [
            store.deserialize_cdr(data, connection.msgtype) for connection, _, data in reader.messages(connections)
        ]
    psnr = []
    for frame, image in zip(shown, images):
        decoded = cv2.imdecode(numpy.asarray(image.data, dtype=numpy.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
        error = numpy.mean((decoded.astype(float) - frame.astype(float)) ** 2)
        psnr.append(10 * math.log10(255**2 / max(error, 1e-9)))
    print(
        json.dumps(
            {
                "video_frames": len(shown),
                "bag_frames": len(images),
                "psnr_min": min(psnr),
                "psnr_mean": sum(psnr) / len(psnr),
            }
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
