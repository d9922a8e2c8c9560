"""A LeRobot checkpoint in the imagined environment: python3 lerobot_checkpoint.py PRETRAINED_MODEL

usage: wm eval policy --model tiny --bags BAGS \\
           --policy-command 'python3 examples/imagined_policy/lerobot_checkpoint.py outputs/act/checkpoints/last/pretrained_model'

PRETRAINED_MODEL is a folder that `lerobot-train` wrote, of a policy that acts from the newest pictures, such as ACT. Refused are
policies that want the robot's state, which an imagined robot has not, or several observations (Diffusion). Of each chunk, the
policy's `n_action_steps` are executed, in whole model steps. Runs on the CPU. Tried with ACT of lerobot 0.4.4
(../../tests/requirements-lerobot.txt).
"""

import base64
import contextlib
import io
import json
import sys

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.policies.utils import prepare_observation_for_inference
from lerobot.utils.constants import OBS_STATE
from PIL import Image

VERSION = 1  # of the protocol
CPU = torch.device("cpu")


class Checkpoint:
    """A policy of LeRobot with its processors."""

    def __init__(self, folder):
        config = PreTrainedConfig.from_pretrained(folder)
        config.device = "cpu"
        self.cameras = config.image_features
        others = sorted(set(config.input_features) - set(self.cameras))
        if others:
            raise ValueError(f"{folder} wants {', '.join(others)}: an imagined robot has pictures only")
        if config.n_obs_steps != 1:
            raise ValueError(f"{folder} wants {config.n_obs_steps} observations: only the newest one is sent")
        self.policy = get_policy_class(config.type).from_pretrained(folder, config=config).eval()
        on_cpu = {"device_processor": {"device": "cpu"}}
        self.before, self.after = make_pre_post_processors(config, folder, preprocessor_overrides=on_cpu)

    def pictures(self, request):
        """The pictures of the policy's cameras, in their order, as (height, width, 3) bytes."""
        if len(self.cameras) != request["views"]:
            raise ValueError(f"{request['views']} cameras, but the policy learnt {len(self.cameras)}")
        whole = Image.open(io.BytesIO(base64.b64decode(request["image"]))).convert("RGB")
        width = whole.width // request["views"]
        found = {}
        for index, (name, feature) in enumerate(self.cameras.items()):
            _, rows, columns = feature.shape
            view = whole.crop((index * width, 0, (index + 1) * width, whole.height))
            found[name] = np.array(view.resize((columns, rows), Image.Resampling.BILINEAR))
        return found

    def act(self, request):
        """The actions that lead to the next pictures, in the units of the action space."""
        if request["version"] != VERSION:
            raise ValueError(f"protocol {request['version']}, expected {VERSION}")
        space = request["action_space"]
        torch.manual_seed(request["seed"] * 1000 + request["step"])
        with torch.inference_mode():
            observation = prepare_observation_for_inference(self.pictures(request), CPU, request["instruction"])
            observation = self.before(observation)
            # ACT asks for the device of a state, even if it was trained without one.
            observation.setdefault(OBS_STATE, torch.zeros(1, 1))
            # Not select_action: requests of several trials alternate, but its queue of actions is one.
            chunk = self.after(self.policy.predict_action_chunk(observation))[0]
        if chunk.shape[1] != len(space["names"]):
            raise ValueError(f"actions of {len(space['names'])} values, but the policy learnt {chunk.shape[1]}")
        per_step = space["actions_per_step"]
        chosen = min(self.policy.config.n_action_steps, len(chunk))
        chunk = chunk[: chosen - chosen % per_step or chosen].tolist()
        is_binary = [kind == "gripper_binary" for kind in space["kinds"]]
        return [
            [float(round(min(max(value, 0.0), 1.0))) if binary else value for value, binary in zip(action, is_binary)]
            for action in chunk
        ]


def main():
    if len(sys.argv) != 2:
        sys.exit("expected a folder that lerobot-train wrote, .../pretrained_model")
    torch.set_num_threads(1)
    # Standard output has answers only; the library prints to it.
    with contextlib.redirect_stdout(sys.stderr):
        try:
            checkpoint = Checkpoint(sys.argv[1])
        except ValueError as error:
            sys.exit(str(error))
    for line in sys.stdin:
        try:
            with contextlib.redirect_stdout(sys.stderr):
                answer = {"actions": checkpoint.act(json.loads(line))}
        except (KeyError, TypeError, ValueError, OSError, RuntimeError) as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
