"""Writes bags with rosbags, an independent writer, and prints their contents.

    python bags_write.py OUT       OUT: a directory that exists; the bags go below it

One bag for each version of metadata.yaml and each compression that rosbags offers. Prints JSON: {bag name:
[[topic, type, log time, sha256 of the CDR], ...]}; messages of equal time in the order of writing.
"""

import hashlib
import json
import random
import sys
from pathlib import Path

import numpy
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000_000_000_000
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(9223372036, 854775807),
    QosTime(9223372036, 854775807),
    QosLiveliness.AUTOMATIC,
    QosTime(9223372036, 854775807),
    False,
)


def write(path, version, compression):
    store = get_typestore(Stores.ROS2_KILTED)
    types = store.types
    generator = random.Random(7)
    writer = Writer(path, version=version, storage_plugin=StoragePlugin.MCAP)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    written = []
    with writer:
        texts = writer.add_connection(
            "/task/instruction", "std_msgs/msg/String", typestore=store, offered_qos_profiles=[LATCHED]
        )
        images = writer.add_connection("/camera/image_raw", "sensor_msgs/msg/Image", typestore=store)

        def add(connection, time, message):
            data = store.serialize_cdr(message, connection.msgtype)
            writer.write(connection, time, data)
            written.append([connection.topic, connection.msgtype, time, hashlib.sha256(data).hexdigest()])

        add(texts, START, types["std_msgs/msg/String"]("pick up the \N{HOT BEVERAGE}"))
        for frame in range(40):
            time = START + frame * 200_000_000
            header = types["std_msgs/msg/Header"](
                types["builtin_interfaces/msg/Time"](time // 10**9, time % 10**9), "camera_optical_frame"
            )
            pixels = numpy.frombuffer(generator.randbytes(96 * 128 * 3), dtype=numpy.uint8)
            add(images, time, types["sensor_msgs/msg/Image"](header, 96, 128, "rgb8", 0, 384, pixels))
    return written


def main(out):
    bags = {}
    for version in (8, 9):
        bags[f"v{version}"] = write(Path(out) / f"v{version}", version, None)
        for mode in (CompressionMode.STORAGE, CompressionMode.MESSAGE, CompressionMode.FILE):
            name = f"v{version}_{mode.name.lower()}"
            bags[name] = write(Path(out) / name, version, mode)
    print(json.dumps(bags))


if __name__ == "__main__":
    main(sys.argv[1])
