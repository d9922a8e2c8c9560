"""A policy of a LeRobot async policy server (python -m lerobot.async_inference.policy_server) on /wm/action_chunk.

usage: python examples/lerobot_policy.py --policy TYPE --checkpoint NAME --rate HZ --state VALUES ... (--help lists all)

It needs ROS 2 with wm_msgs, and lerobot[async]==0.4.4 from PyPI. A SO-101, whose policies use degrees and per cent:

    python examples/lerobot_policy.py --policy smolvla --checkpoint lerobot/smolvla_base --rate 30 \\
        --image front=/camera/image_raw --frame base_link \\
        --state 'observation.state=pan*57.2958,lift*57.2958,elbow*57.2958,flex*57.2958,roll*57.2958,gripper*100' \\
        --action 'pan*0.0174533,lift*0.0174533,elbow*0.0174533,flex*0.0174533,roll*0.0174533,gripper*0.01'

The server unpickles what its clients send, so every client can run code on it, and it encrypts nothing: leave it on
localhost, and reach it by `ssh -L 8080:localhost:8080 HOST`. Its answers are pickles too: this program refuses a pickle
that names anything but actions.
"""

import collections
import io
import itertools
import pickle
import time

import grpc
import torch
from lerobot.async_inference.helpers import RemotePolicyConfig, TimedAction, TimedObservation
from lerobot.transport.services_pb2 import Empty, Observation, PolicySetup
from lerobot.transport.services_pb2_grpc import AsyncInferenceStub
from lerobot.transport.utils import grpc_channel_options, send_bytes_in_chunks
from policy_bridge import Refusal, number, parse, parser, run


class ActionsUnpickler(pickle.Unpickler):
    """Reads lists of TimedAction. A pickle may name any function; all but the few that build actions are refused."""

    KNOWN = {
        ("collections", "OrderedDict"): collections.OrderedDict,
        ("lerobot.async_inference.helpers", "TimedAction"): TimedAction,
        ("torch._utils", "_rebuild_tensor_v2"): torch._utils._rebuild_tensor_v2,
        # torch's own function of this name executes what the data names
        ("torch.storage", "_load_from_bytes"): lambda data: torch.load(io.BytesIO(data), weights_only=True),
    }

    def find_class(self, module, name):
        if (module, name) not in self.KNOWN:
            raise Refusal("unsafe", f"expected actions, found a pickle that names {module}.{name}")
        return self.KNOWN[module, name]


def actions_of(data, timestep, rate):
    """The actions [actions, values] of an answer to the observation `timestep`."""
    try:
        timed = ActionsUnpickler(io.BytesIO(data)).load()
        steps, times = [action.timestep for action in timed], [action.timestamp for action in timed]
        actions = torch.stack([action.action for action in timed]).float().numpy()
        duration, expected = times[-1] - times[0], (len(timed) - 1) / rate
    except Refusal:
        raise
    except Exception as error:  # what unpickling raises depends on the bytes
        raise Refusal("shape", f"expected a list of actions: {type(error).__name__}: {error}") from error
    if steps != list(range(timestep, timestep + len(steps))):
        raise Refusal("old_answer", f"expected actions from step {timestep} on, found {steps[:3]}...")
    if not abs(duration - expected) <= 0.01 * expected:
        found = f"found {duration:.3f} s: --rate and the server's --fps differ"
        raise Refusal("period", f"expected {expected:.3f} s from the first to the last action, {found}")
    return actions


def main():
    options = parser(__doc__, server="localhost:8080", image="front=/camera/image_raw")
    options.add_argument("--policy", required=True, help="type of the policy: act, smolvla, pi0, ...")
    options.add_argument("--checkpoint", required=True, help="folder on the server, or name on Hugging Face")
    options.add_argument("--device", default="cuda", help="of the server (%(default)s)")
    options.add_argument("--timeout", type=number(float, 0.001), default=10.0, help="for an answer [s] (%(default)s)")
    arguments = parse(options)
    timesteps = itertools.count()

    def connect(observation):
        stub = AsyncInferenceStub(grpc.insecure_channel(arguments.server, grpc_channel_options()))
        names = [name for values in arguments.state.values() for name in values.names]
        features = {"observation.state": {"dtype": "float32", "shape": (len(names),), "names": names}}
        for key, picture in observation.pictures.items():
            axes = ["height", "width", "channels"]
            features[f"observation.images.{key}"] = {"dtype": "image", "shape": picture.shape, "names": axes}
        policy, checkpoint = arguments.policy, arguments.checkpoint
        setup = RemotePolicyConfig(policy, checkpoint, features, arguments.actions, arguments.device)
        stub.Ready(Empty(), timeout=arguments.timeout)
        # the server loads the checkpoint, and may download it first
        stub.SendPolicyInstructions(PolicySetup(data=pickle.dumps(setup)))

        def infer(observation):
            timestep = next(timesteps)
            state = itertools.chain(*(state.tolist() for state in observation.states.values()))
            raw = {**dict(zip(names, state)), **observation.pictures, "task": observation.instruction}
            sent = pickle.dumps(TimedObservation(time.time(), timestep, raw, must_go=True))
            stub.SendObservations(send_bytes_in_chunks(sent, Observation), timeout=arguments.timeout)
            data = stub.GetActions(Empty(), timeout=arguments.timeout).data
            if not data:  # it does so for every error of its own
                raise ConnectionError("the server gave no actions: see its log")
            return actions_of(data, timestep, arguments.rate)

        return infer

    run("lerobot_policy", arguments, connect)


if __name__ == "__main__":
    main()
