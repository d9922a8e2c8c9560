"""Tests of openvla_policy.py's functions that need no weights: python examples/test_openvla_policy.py"""

import io
import unittest

import numpy as np
from openvla_policy import BINS, SIDE, normalized, prepare, prompt, unnormalize
from PIL import Image

# Statistics like those of bridge_orig: metres, radians, and a gripper that is not normalised.
STATISTICS = {
    "q01": [-0.0287, -0.0417, -0.0261, -0.0809, -0.0929, -0.2072, 0.0],
    "q99": [0.0283, 0.0409, 0.0402, 0.0819, 0.0779, 0.2038, 1.0],
    "mask": [True] * 6 + [False],
}
# The last 256 of Llama's 32000 tokens are actions; the checkpoint pads the vocabulary to 32064.
VOCABULARY = 32000


class Actions(unittest.TestCase):
    def test_the_quantiles_are_what_minus_one_and_one_become(self):
        np.testing.assert_allclose(unnormalize([-1.0] * 6 + [0.0], STATISTICS), STATISTICS["q01"], rtol=1e-6)
        np.testing.assert_allclose(unnormalize([1.0] * 7, STATISTICS), STATISTICS["q99"], rtol=1e-6)

    def test_the_middle_is_the_mean_of_the_quantiles_and_the_gripper_stays(self):
        physical = unnormalize([0.0] * 6 + [0.996], STATISTICS)
        np.testing.assert_allclose(physical[:6], np.add(STATISTICS["q01"], STATISTICS["q99"])[:6] / 2, rtol=1e-5)
        self.assertAlmostEqual(float(physical[6]), 0.996, places=6)

    def test_a_gripper_between_minus_one_and_one_is_clipped_to_an_opening(self):
        self.assertEqual(unnormalize([0.0] * 6 + [-0.3], STATISTICS)[6], 0.0)

    def test_without_a_mask_every_coordinate_is_spread(self):
        statistics = {key: STATISTICS[key] for key in ("q01", "q99")}
        self.assertAlmostEqual(float(unnormalize([0.0] * 7, statistics)[6]), 0.5)

    def test_what_does_not_fit_is_refused(self):
        for action in ([0.0] * 6, [0.0] * 6 + [float("nan")]):
            with self.assertRaises(ValueError):
                unnormalize(action, STATISTICS)


class Tokens(unittest.TestCase):
    def test_tokens_count_down_from_the_end_of_the_vocabulary(self):
        width = 2.0 / (BINS - 1)
        actions = normalized([VOCABULARY - 1, VOCABULARY - 2, VOCABULARY - (BINS - 1)], VOCABULARY)
        np.testing.assert_allclose(actions, [-1 + width / 2, -1 + 3 * width / 2, 1 - width / 2], atol=1e-12)

    def test_the_edges_tokens_are_those_of_the_outer_bins(self):
        outer = normalized([VOCABULARY, VOCABULARY - BINS, 5], VOCABULARY)
        np.testing.assert_allclose(outer, normalized([VOCABULARY - 1, VOCABULARY - BINS + 1, VOCABULARY - BINS + 1], VOCABULARY))

    def test_every_bin_comes_back_through_its_action(self):
        tokens = np.arange(VOCABULARY - (BINS - 1), VOCABULARY)
        actions = normalized(tokens, VOCABULARY)
        back = VOCABULARY - np.digitize(actions, np.linspace(-1.0, 1.0, BINS))
        np.testing.assert_array_equal(back, tokens)


class Inputs(unittest.TestCase):
    def test_the_prompt_is_the_training_prompt(self):
        text = "In: What action should the robot take to put the cup on the plate?\nOut:"
        self.assertEqual(prompt(" Put the Cup on the plate "), text)

    def test_a_picture_has_the_models_size_and_colours(self):
        picture = Image.new("RGB", (128, 96), (200, 30, 60))
        data = io.BytesIO()
        picture.save(data, "JPEG", quality=95)
        prepared = prepare(data.getvalue())
        self.assertEqual((prepared.size, prepared.mode), ((SIDE, SIDE), "RGB"))
        np.testing.assert_allclose(np.asarray(prepared)[100, 100], (200, 30, 60), atol=4)

    def test_a_centre_crop_keeps_the_middle(self):
        picture = Image.new("L", (100, 100), 0)
        picture.paste(255, (3, 3, 97, 97))
        data = io.BytesIO()
        picture.save(data, "PNG")
        self.assertEqual(int(np.asarray(prepare(data.getvalue(), center_crop=True)).min()), 255)
        self.assertEqual(int(np.asarray(prepare(data.getvalue()))[0, 0, 0]), 0)


if __name__ == "__main__":
    unittest.main()
