"""A small policy that is cloned from bags: a convolutional network from a picture and an instruction to an action."""

import re

import torch
from torch import nn

SIZE = 128  # height and width of the pictures [px]
WORDS = 16  # words of an instruction that are read


def words(instruction):
    return re.findall(r"[a-z]+", instruction.lower())[:WORDS]


class Vocabulary:
    """Words of the training's instructions; 0 stands for none, 1 for others."""

    def __init__(self, known):
        self.known = list(known)
        self.index = {word: number for number, word in enumerate(self.known, start=2)}

    def __len__(self):
        return len(self.known) + 2

    def encode(self, instruction):
        found = [self.index.get(word, 1) for word in words(instruction)]
        return torch.tensor(found + [0] * (WORDS - len(found)))


class ClonedPolicy(nn.Module):
    """Pictures (N, 3, SIZE, SIZE) in 0..1 and words (N, WORDS) to actions (N, A), as multiples of their deviation."""

    def __init__(self, vocabulary, actions, width=32):
        super().__init__()
        self.embedding = nn.Embedding(vocabulary, 32)
        self.text = nn.GRU(32, 64, batch_first=True)
        self.convolutions = nn.ModuleList(
            [
                nn.Conv2d(3, width, 8, stride=4, padding=2),
                nn.Conv2d(width, 2 * width, 3, stride=2, padding=1),
                nn.Conv2d(2 * width, 2 * width, 3, padding=1),
            ]
        )
        # what the instruction names is weighted after each convolution
        self.scales = nn.ModuleList(nn.Linear(64, 2 * own.out_channels) for own in self.convolutions)
        self.head = nn.Sequential(nn.Linear(2 * width * 6 + 64, 256), nn.ReLU(), nn.Linear(256, actions))

    def forward(self, pictures, instructions):
        text = self.text(self.embedding(instructions))[1][0]
        features = 2.0 * pictures - 1.0
        for convolution, scale in zip(self.convolutions, self.scales):
            gain, offset = scale(text)[:, :, None, None].chunk(2, dim=1)
            features = nn.functional.relu(convolution(features) * (1.0 + gain) + offset)
        # where each feature is (spatial softmax), and how strong on the picture's quarters
        weights = (features.flatten(2)).softmax(-1)
        along = torch.linspace(-1.0, 1.0, features.shape[-1])
        rows, columns = (axis.flatten() for axis in torch.meshgrid(along, along, indexing="ij"))
        places = torch.cat([weights @ rows, weights @ columns], 1)
        quarters = nn.functional.adaptive_avg_pool2d(features, 2).flatten(1)
        return self.head(torch.cat([places, quarters, text], 1))


def load(path):
    """The network, its vocabulary, and the mean and deviation of the actions."""
    stored = torch.load(path, weights_only=True)
    vocabulary = Vocabulary(stored["words"])
    policy = ClonedPolicy(len(vocabulary), len(stored["mean"]))
    policy.load_state_dict(stored["weights"])
    return policy.eval(), vocabulary, stored["mean"], stored["deviation"]
