"""The cloned policy for `wm eval policy` and `wm eval imagined`: python3 policy.py policy.pt

JSON lines in, JSON lines out, by the protocol of ../imagined_policy/README.md. It depends on nothing but the request.
"""

import base64
import io
import json
import sys

import numpy as np
import torch
from PIL import Image

from cloned import SIZE, load

VERSION = 1  # of the protocol


def act(request, policy, vocabulary, mean, deviation):
    """The actions that lead to the next picture, in the units of the action space: the same one repeated."""
    if request["version"] != VERSION:
        raise ValueError(f"protocol {request['version']}, expected {VERSION}")
    space = request["action_space"]
    if len(space["names"]) != len(mean):
        raise ValueError(f"actions of {len(space['names'])} values, but the policy learnt {len(mean)}")
    picture = Image.open(io.BytesIO(base64.b64decode(request["image"]))).convert("RGB")
    picture = np.asarray(picture.resize((SIZE, SIZE), Image.Resampling.BOX))
    picture = torch.from_numpy(picture.copy()).permute(2, 0, 1)[None].float() / 255.0
    with torch.inference_mode():
        values = policy(picture, vocabulary.encode(request["instruction"])[None])[0] * deviation + mean
    values = [
        float(round(min(max(value, 0.0), 1.0))) if kind == "gripper_binary" else value
        for value, kind in zip(values.tolist(), space["kinds"])
    ]
    return [values] * space["actions_per_step"]


def main():
    if len(sys.argv) != 2:
        sys.exit("expected the policy that train.py wrote")
    torch.set_num_threads(1)
    learnt = load(sys.argv[1])
    for line in sys.stdin:
        try:
            answer = {"actions": act(json.loads(line), *learnt)}
        except (KeyError, TypeError, ValueError, OSError) as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
