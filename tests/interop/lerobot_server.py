"""LeRobot's own policy server with a small ACT policy of random weights, made from a fixed seed.

usage: lerobot_server.py PORT FOLDER

FOLDER gets the policy, as `checkpoint`, and then expected.json: the eight actions of seven values that LeRobot's code
computes for the picture and state of tests/policy_servers.rs. Then the server runs, at 10 actions per second.
"""

import json
import pathlib
import pickle
import sys
import time
from concurrent import futures
from types import SimpleNamespace

import grpc
import numpy as np
import torch
from lerobot.async_inference.configs import PolicyServerConfig
from lerobot.async_inference.helpers import RemotePolicyConfig, TimedObservation
from lerobot.async_inference.policy_server import PolicyServer
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.transport import services_pb2_grpc

HEIGHT, WIDTH, ACTIONS, VALUES = 48, 64, 8, 7
port, folder = sys.argv[1], pathlib.Path(sys.argv[2])
torch.manual_seed(7)
torch.set_num_threads(1)
config = ACTConfig(
    input_features={
        "observation.images.front": PolicyFeature(FeatureType.VISUAL, (3, HEIGHT, WIDTH)),
        "observation.state": PolicyFeature(FeatureType.STATE, (2,)),
    },
    output_features={"action": PolicyFeature(FeatureType.ACTION, (VALUES,))},
    device="cpu", pretrained_backbone_weights=None, use_vae=False, chunk_size=ACTIONS, n_action_steps=ACTIONS,
    dim_model=32, n_heads=2, dim_feedforward=32, n_encoder_layers=1,
)  # fmt: skip
checkpoint = folder / "checkpoint"
ACTPolicy(config).save_pretrained(checkpoint)
statistics = {
    "observation.images.front": {"mean": torch.full((3, 1, 1), 0.5), "std": torch.full((3, 1, 1), 0.25)},
    "observation.state": {"mean": torch.zeros(2), "std": torch.tensor([1.0, 50.0])},
    "action": {"mean": torch.arange(VALUES).float(), "std": torch.full((VALUES,), 0.5)},
}
for processor in make_pre_post_processors(config, dataset_stats=statistics):
    processor.save_pretrained(checkpoint)


def served():
    return PolicyServer(PolicyServerConfig(host="localhost", port=int(port), fps=10, inference_latency=0.0))


def expected():
    features = {
        "observation.state": {"dtype": "float32", "shape": (2,), "names": ["shoulder", "gripper"]},
        "observation.images.front": {"dtype": "image", "shape": (HEIGHT, WIDTH, 3), "names": ["h", "w", "c"]},
    }
    setup = RemotePolicyConfig("act", str(checkpoint), features, ACTIONS, "cpu")
    server = served()
    server.SendPolicyInstructions(SimpleNamespace(data=pickle.dumps(setup)), SimpleNamespace(peer=lambda: ""))
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[:, : WIDTH // 2], picture[:, WIDTH // 2 :] = (10, 20, 30), (250, 0, 0)
    raw = {"shoulder": -1.0, "gripper": 25.0, "front": picture, "task": "lift the cup"}
    chunk = server._predict_action_chunk(TimedObservation(time.time(), 0, raw))
    return [action.action.tolist() for action in chunk]


whole = json.dumps(expected())
(folder / "expected.part").write_text(whole)
(folder / "expected.part").rename(folder / "expected.json")
server = grpc.server(futures.ThreadPoolExecutor(max_workers=2))
services_pb2_grpc.add_AsyncInferenceServicer_to_server(served(), server)
server.add_insecure_port(f"localhost:{port}")
server.start()
server.wait_for_termination()
