"""Tests of policy_bridge.py's functions that need no server: python examples/test_policy_bridge.py   (ROS 2 sourced)"""

import argparse
import io
import unittest

import numpy as np
from PIL import Image as Pillow
from policy_bridge import MOST_ACTIONS, Refusal, Values, checked, picture, stamp_of
from sensor_msgs.msg import CompressedImage, Image


def message(encoding, pixels, padding=0, **other):
    height, row = pixels.shape[0], pixels.reshape(len(pixels), -1)
    data = np.pad(row, ((0, 0), (0, padding)), constant_values=77)
    fields = {"height": height, "width": pixels.shape[1], "step": data.shape[1], "data": data.tobytes(), **other}
    return Image(encoding=encoding, **fields)


class TestValues(unittest.TestCase):
    def test_values_are_scaled_and_then_shifted(self):
        values = Values("x, y*1e-3,gripper*-1+1,z*.5+-2")
        self.assertEqual(values.names, ["x", "y", "gripper", "z"])
        np.testing.assert_allclose(values.convert(np.array([[1.0, 2.0, 0.25, 3.0]])), [[1.0, 0.002, 0.75, -0.5]])

    def test_malformed_values_are_refused(self):
        for text in ("", "x,", "x*", "x*y", "x+", "x*nan", "x*1*2", "x y", "*2", "x*inf"):
            with self.assertRaises(argparse.ArgumentTypeError, msg=text):
                Values(text)


class TestStamp(unittest.TestCase):
    def test_stamps_that_are_no_time_are_refused(self):
        image = Image()
        image.header.stamp.sec, image.header.stamp.nanosec = 2**31 - 1, 10**9 - 1
        self.assertEqual(stamp_of(image), 2**31 * 10**9 - 1)
        for sec, nanosec in ((0, 0), (-1, 0), (-1, 10**9 - 1), (1, 10**9), (1, 2**32 - 1)):
            image.header.stamp.sec, image.header.stamp.nanosec = sec, nanosec
            with self.assertRaises(Refusal) as raised:
                stamp_of(image)
            self.assertEqual(raised.exception.reason, "bad_stamp")


class TestPicture(unittest.TestCase):
    def test_every_encoding_becomes_rgb(self):
        rgb = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
        alpha = np.full((2, 3, 1), 255, np.uint8)
        gray = rgb[..., :1]
        for encoding, pixels in {
            "rgb8": rgb, "bgr8": rgb[..., ::-1], "rgba8": np.dstack([rgb, alpha]),
            "bgra8": np.dstack([rgb[..., ::-1], alpha]), "mono8": gray,
        }.items():  # fmt: skip
            for padding in (0, 5):
                with self.subTest(encoding=encoding, padding=padding):
                    expected = np.repeat(gray, 3, axis=2) if encoding == "mono8" else rgb
                    np.testing.assert_array_equal(picture(message(encoding, pixels, padding)), expected)

    def test_compressed_pictures_are_decoded(self):
        rgb = np.arange(4 * 4 * 3, dtype=np.uint8).reshape(4, 4, 3)
        stored = io.BytesIO()
        Pillow.fromarray(rgb).save(stored, "PNG")
        np.testing.assert_array_equal(picture(CompressedImage(format="png", data=stored.getvalue())), rgb)

    def test_damaged_pictures_are_refused(self):
        rgb = np.zeros((4, 4, 3), np.uint8)
        stored = io.BytesIO()
        Pillow.fromarray(rgb).save(stored, "PNG")
        for damaged in (
            message("rgb8", rgb, data=b"\0" * 47),
            message("rgb8", rgb, step=11),
            message("rgb8", rgb, step=2**32 - 1),
            message("rgb8", rgb, width=2**32 - 1),
            message("rgb8", rgb, width=0, step=0, data=b""),
            message("rgb8", rgb, height=0, data=b""),
            message("16UC1", rgb),
            message("", rgb),
            CompressedImage(format="png", data=stored.getvalue()[:-30]),
            CompressedImage(format="jpeg", data=b"no picture"),
            CompressedImage(),
        ):
            with self.assertRaises(Refusal) as raised:
                picture(damaged)
            self.assertEqual(raised.exception.reason, "bad_image")


class TestChecked(unittest.TestCase):
    VALUES = Values("x*0.1,gripper*-1+1")

    def test_first_actions_are_converted(self):
        actions = checked(np.array([[1.0, 0.0], [2.0, 1.0], [3.0, 0.5]]), self.VALUES, most=2)
        np.testing.assert_allclose(actions, [[0.1, 1.0], [0.2, 0.0]], rtol=1e-6)
        self.assertEqual(actions.dtype, np.float32)
        for kind in (np.float16, np.float32, np.int8, bool):
            checked(np.ones((3, 2), kind), self.VALUES)

    def refused(self, answer):
        with self.assertRaises(Refusal, msg=repr(answer)) as raised:
            checked(answer, self.VALUES)
        return raised.exception.reason

    def test_answers_of_another_shape_are_refused(self):
        ones = np.ones((3, 2))
        for answer in (
            ones[0], ones[:0], ones[:, :1], ones[None], np.ones((3, 3)), np.ones((MOST_ACTIONS + 1, 2)),
            None, "actions", 1.0, [], [[1.0, 2.0], [1.0]], {"actions": ones}, np.array([["a", "b"]]), b"\0" * 16,
        ):  # fmt: skip
            self.assertEqual(self.refused(answer), "shape")

    def test_answers_that_are_not_finite_are_refused(self):
        for value in (np.nan, np.inf, -np.inf, 1e300):
            answer = np.ones((3, 2))
            answer[2, 1] = value
            self.assertEqual(self.refused(answer), "not_finite")
        self.assertEqual(self.refused([[1.0, None]]), "not_finite")


if __name__ == "__main__":
    unittest.main()
