"""Times of training steps, from the TensorBoard file of a training."""

import struct


def step_times(path):
    """Milliseconds of each step but the first, of an event file: TFRecords that begin with the wall time and the step."""
    data, at, times = path.read_bytes(), 0, {}
    while at < len(data):
        (length,) = struct.unpack_from("<Q", data, at)
        event = data[at + 12 : at + 12 + length]
        at += 16 + length
        if event[:1] == b"\x09" and event[9:10] == b"\x10" and event[10] < 128:
            times.setdefault(event[10], struct.unpack_from("<d", event, 1)[0])
    ordered = [times[step] for step in sorted(times)]
    return [(b - a) * 1e3 for a, b in zip(ordered, ordered[1:])]
