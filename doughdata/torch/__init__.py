"""Datasets for PyTorch: single views, sequences for dynamics, and an order that can be resumed.

loader = DataLoader(dataset := DoughDataset("dough-dataset"), batch_size=8, num_workers=2,
                    sampler=EndlessSampler(dataset))
"""

from doughdata.torch.frames import DoughDataset
from doughdata.torch.sampler import EndlessSampler
from doughdata.torch.sequences import DoughSequences

__all__ = ["DoughDataset", "DoughSequences", "EndlessSampler"]
