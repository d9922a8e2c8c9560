"""Tests of lerobot_checkpoint.py, with an untrained ACT: python examples/imagined_policy/test_lerobot_checkpoint.py"""

import base64
import io
import pathlib
import tempfile
import unittest

import numpy as np
import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.factory import make_pre_post_processors
from lerobot_checkpoint import Checkpoint
from PIL import Image

CAMERA, STATE = "observation.images.camera", "observation.state"
KINDS = ["translation_delta", "gripper_binary"]


def saved(folder, inputs):
    """A checkpoint whose actions have mean 2 and deviation 0 in the first value, 0.7 in the second."""
    torch.manual_seed(0)
    visual = PolicyFeature(FeatureType.VISUAL, (3, 64, 64))
    of = {CAMERA: visual, "observation.images.wrist": visual, STATE: PolicyFeature(FeatureType.STATE, (3,))}
    config = ACTConfig(
        device="cpu",
        input_features={name: of[name] for name in inputs},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
        pretrained_backbone_weights=None,
        dim_model=32,
        n_heads=2,
        dim_feedforward=32,
        n_encoder_layers=1,
        use_vae=False,
        chunk_size=6,
        n_action_steps=5,
    )
    ACTPolicy(config).save_pretrained(folder)
    stats = {name: {"mean": torch.zeros(3, 1, 1), "std": torch.ones(3, 1, 1)} for name in inputs if "images" in name}
    stats["action"] = {"mean": torch.tensor([2.0, 0.7]), "std": torch.zeros(2)}
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(folder)


def request(views=1, per_step=2, names=("dx", "gripper")):
    picture = np.random.default_rng(0).integers(256, size=(128, 128 * views, 3), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    space = {"names": list(names), "kinds": KINDS, "actions_per_step": per_step}
    image = base64.b64encode(file.getvalue()).decode()
    return dict(version=1, seed=3, step=0, instruction="push", image=image, views=views, action_space=space)


class TestCheckpoint(unittest.TestCase):
    def checkpoint(self, *inputs):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        saved(pathlib.Path(folder.name), inputs)
        return Checkpoint(folder.name)

    def test_actions_are_in_units_and_whole_steps(self):
        checkpoint = self.checkpoint(CAMERA)
        actions = checkpoint.act(request())
        # of five actions, two whole steps of two; the gripper's .7 is open
        np.testing.assert_allclose(actions, [[2.0, 1.0]] * 4, atol=1e-3)
        self.assertEqual(actions, checkpoint.act(request()))
        self.assertEqual(len(checkpoint.act(request(per_step=7))), 5)

    def test_cameras_lie_side_by_side(self):
        checkpoint = self.checkpoint(CAMERA, "observation.images.wrist")
        both = checkpoint.pictures(request(views=2))
        self.assertEqual({picture.shape for picture in both.values()}, {(64, 64, 3)})
        self.assertFalse((both[CAMERA] == both["observation.images.wrist"]).all())
        with self.assertRaisesRegex(ValueError, "1 cameras, but the policy learnt 2"):
            checkpoint.act(request())

    def test_what_does_not_fit_is_refused(self):
        with self.assertRaisesRegex(ValueError, STATE):
            self.checkpoint(CAMERA, STATE)
        with tempfile.TemporaryDirectory() as folder:
            features = {CAMERA: PolicyFeature(FeatureType.VISUAL, (3, 64, 64))}
            DiffusionConfig(device="cpu", input_features=features).save_pretrained(folder)
            with self.assertRaisesRegex(ValueError, "wants 2 observations"):
                Checkpoint(folder)
        checkpoint = self.checkpoint(CAMERA)
        with self.assertRaisesRegex(ValueError, "actions of 3 values, but the policy learnt 2"):
            checkpoint.act(request(names=("dx", "dy", "gripper")))
        with self.assertRaisesRegex(ValueError, "protocol 2"):
            checkpoint.act(request() | {"version": 2})


if __name__ == "__main__":
    unittest.main()
