"""The memory of an NVIDIA GPU that a measurement takes."""

import threading

import torch


class CardMemory:
    """The greatest loss of free memory of the card since the beginning, in MiB."""

    def __enter__(self):
        self.least = self.before = torch.cuda.mem_get_info()[0]
        self.is_done = threading.Event()
        self.thread = threading.Thread(target=self.watch)
        self.thread.start()
        return self

    def watch(self):
        while not self.is_done.wait(0.01):
            self.least = min(self.least, torch.cuda.mem_get_info()[0])

    def __exit__(self, *_):
        self.is_done.set()
        self.thread.join()

    def most(self):
        return (self.before - self.least) / 2**20
